// presence, distance_change: the view of a person at a frame. `clear` is 1 in clear view. A person without a box is
// absent if the frame and both neighbouring keyframes are annotated (3). `distance` is in metres, null if unknown.
UNWIND $plans AS q
WITH q.id AS id, q.scope AS scope, q.who AS who, q.t AS t
UNWIND [t - 15, t, t + 15] AS near
OPTIONAL MATCH (f:Frame)
WHERE f.sequence = scope AND f.frame = near AND f.annotated
WITH id, scope, who, t, near, count(f) AS annotated
OPTIONAL MATCH (p:Person)-[s:SeenIn]->(:Frame)
WHERE s.sequence = scope AND s.frame = near AND p.track = who
WITH id, t, near, annotated, count(s) AS boxes,
     max(CASE WHEN near = t AND s.clear = true THEN 1 ELSE 0 END) AS clear,
     max(CASE WHEN near = t AND s.located = true THEN s.distance END) AS distance
RETURN id, t, sum(annotated) AS annotated, sum(boxes) AS boxes, max(clear) AS clear, max(distance) AS distance
ORDER BY id, t
