// For the read count: the plans with a person who has a box at every keyframe from frame t1 to frame t2.
UNWIND $plans AS q
WITH q.id AS id, q.scope AS scope, q.who AS who, q.t1 AS t1, q.t2 AS t2, q.step AS step
MATCH (f:Frame)
WHERE f.sequence = scope AND f.keyframe AND f.frame >= t1 AND f.frame <= t2
WITH id, scope, who, t1, t2, step, count(*) AS keyframes
MATCH (p:Person)-[s:SeenIn]->(f:Frame)
WHERE p.sequence = scope AND p.track = who AND f.keyframe AND f.frame >= t1 AND f.frame <= t2
WITH id, t1, t2, step, keyframes, count(*) AS boxes
WHERE boxes = CASE WHEN step = 1 THEN t2 / 15 - (t1 + 14) / 15 + 1 ELSE keyframes END
RETURN id
ORDER BY id
