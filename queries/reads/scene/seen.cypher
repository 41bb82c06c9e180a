// For the reads presence and distance_change: how a person is seen at frame t. `clear` is 1 if the person is in clear
// view at t. `absent` is true if t and the keyframes before and after it are annotated, and the person has no box at any
// of the three. `distance` is in metres.
UNWIND $plans AS q
WITH q.id AS id, q.scope AS scope, q.who AS who, q.t AS t
UNWIND [t - 15, t, t + 15] AS near
OPTIONAL MATCH (f:Frame)
WHERE f.sequence = scope AND f.frame = near AND f.annotated
WITH id, scope, who, t, near, count(f) AS annotated
OPTIONAL MATCH (p:Person)-[s:SeenIn]->(:Frame)
WHERE p.sequence IN $scopes AND s.sequence = scope AND s.frame = near AND p.track = who
WITH id, t, near, annotated, count(s) AS boxes,
     max(CASE WHEN near = t AND s.clear = true THEN 1 ELSE 0 END) AS clear,
     max(CASE WHEN near = t AND s.located = true THEN s.distance END) AS distance
RETURN id, t, sum(annotated) = 3 AND sum(boxes) = 0 AS absent, max(clear) AS clear, max(distance) AS distance
ORDER BY id, t
