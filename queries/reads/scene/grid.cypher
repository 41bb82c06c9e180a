// Frames with action labels per sequence: the first and last frame with a list of actions and the step between them;
// also the step between frames with boxes.
MATCH (f:Frame)
WHERE f.annotated
WITH f.sequence AS scope, min(f.frame) AS origin
MATCH (f:Frame)
WHERE f.sequence = scope AND f.annotated
WITH scope, sum(CASE WHEN (f.frame - origin) % 15 = 0 THEN 0 ELSE 1 END) AS between
MATCH (:Person)-[s:SeenIn]->(:Frame)
WHERE s.sequence = scope AND s.listed
WITH scope, between, min(s.frame) AS low, max(s.frame) AS high
MATCH (z:Sequence)
WHERE z.sequence = scope
RETURN scope, low, high, z.action_step AS step, CASE WHEN between = 0 THEN 15 ELSE 1 END AS box_step
ORDER BY scope
