// For the read attribute of a thing: its angle at a frame of the panoptic layer.
UNWIND $plans AS q
WITH q.id AS id, q.scope AS scope, q.who AS who, q.t AS t
MATCH (o:Object)-[s:SeenIn]->(:Frame)
WHERE s.sequence = scope AND s.frame = t AND o.id = who
RETURN id, s.angle AS angle
ORDER BY id
