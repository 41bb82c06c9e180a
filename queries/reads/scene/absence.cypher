// For the read seconds_between: a person's first absence after a frame. The person must be in clear view at every
// keyframe until the absence, and all frames of the absence must be annotated. `leaves` is the frame of the last box before the
// absence, and `returns` the frame of the first box after it.
UNWIND $plans AS q
WITH q.id AS id, q.scope AS scope, q.who AS who, q.after AS after, q.step AS step, q.box_step AS box_step
MATCH (f:Frame)
WHERE f.sequence = scope AND f.keyframe AND f.frame > after
WITH id, scope, who, after, step, box_step, f.frame AS k
UNWIND [k - 15, k, k + 15] AS near
OPTIONAL MATCH (g:Frame)
WHERE g.sequence = scope AND g.frame = near AND g.annotated
WITH id, scope, who, after, step, box_step, k, near, count(g) AS annotated
OPTIONAL MATCH (p:Person)-[s:SeenIn]->(:Frame)
WHERE s.sequence = scope AND s.frame = near AND p.track = who
WITH id, scope, who, after, step, box_step, k, near, annotated, count(s) AS boxes
WITH id, scope, who, after, step, box_step, k, sum(annotated) AS annotated, sum(boxes) AS boxes
WHERE annotated = 3 AND boxes = 0
WITH id, scope, who, after, step, box_step, min(k) AS gone
MATCH (p:Person)-[s:SeenIn]->(:Frame)
WHERE p.sequence = scope AND p.track = who
WITH id, scope, after, step, box_step, p,
     max(CASE WHEN s.frame < gone THEN s.frame END) AS leaves, min(CASE WHEN s.frame > gone THEN s.frame END) AS returns
WHERE leaves >= after AND returns IS NOT NULL
MATCH (f:Frame)
WHERE f.sequence = scope AND f.frame > after AND f.frame < returns
WITH id, after, step, box_step, p, leaves, returns,
     sum(CASE WHEN f.keyframe = true AND f.frame <= leaves THEN 1 ELSE 0 END) AS keyframes,
     sum(CASE WHEN f.annotated = true AND f.frame > leaves THEN 1 ELSE 0 END) AS annotated
WHERE annotated = (returns - leaves + box_step - 1) / box_step - 1
OPTIONAL MATCH (p)-[s:SeenIn]->(f:Frame)
WHERE f.keyframe AND s.clear AND s.frame > after AND s.frame <= leaves
WITH id, after, step, leaves, returns, keyframes, count(s) AS present
WHERE present = CASE WHEN step = 1 THEN leaves / 15 - after / 15 ELSE keyframes END
RETURN id, leaves, returns
ORDER BY id
