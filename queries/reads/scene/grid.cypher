// The first and the last frame with a list of actions in some sequences (`low`, `high`), the number of frames from one
// list to the next (`step`), and the number of frames from one frame with boxes to the next (`box_step`).
MATCH (f:Frame)
WHERE f.sequence IN $scopes AND f.annotated
WITH f.sequence AS scope, min(f.frame) AS origin
MATCH (f:Frame)
WHERE f.sequence = scope AND f.annotated
WITH scope, sum(CASE WHEN (f.frame - origin) % 15 = 0 THEN 0 ELSE 1 END) AS between
MATCH (p:Person)-[s:SeenIn]->(:Frame)
WHERE p.sequence IN $scopes AND p.sequence = scope AND s.listed
WITH scope, between, min(s.frame) AS low, max(s.frame) AS high
MATCH (z:Sequence)
WHERE z.sequence = scope
RETURN scope, low, high, z.action_step AS step, CASE WHEN between = 0 THEN 15 ELSE 1 END AS box_step
ORDER BY scope
