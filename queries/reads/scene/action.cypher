// action: the posture of somebody at a frame. No row, or null, where it is unknown.
UNWIND $plans AS q
WITH q.id AS id, q.scope AS scope, q.who AS who, q.t AS t
MATCH (p:Person)-[s:SeenIn]->(:Frame)
WHERE s.sequence = scope AND s.frame = t AND p.track = who
RETURN id, s.pose AS pose
ORDER BY id
