// For the read attribute: the labels of a person at a frame that shows the person. Unknown labels are null.
UNWIND $plans AS q
WITH q.id AS id, q.scope AS scope, q.who AS who, q.t AS t
MATCH (p:Person)-[s:SeenIn]->(:Frame)
WHERE s.sequence = scope AND s.frame = t AND p.track = who
RETURN id, p.gender AS gender, p.age AS age, s.group_size AS group_size, s.angle AS angle,
       CASE WHEN s.distance_word_other IS NULL THEN s.distance_word END AS distance
ORDER BY id
