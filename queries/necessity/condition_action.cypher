// Return the people in a frame who may perform an action: by a label, or if their list was not read. A label that
// flickers also counts if it is written one second earlier or later.
UNWIND $asked AS q
WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v,
     CASE WHEN list_contains($flickering, q.v) = true THEN 15 ELSE 0 END AS near
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE f.id = at AND NOT s.covered
OPTIONAL MATCH (n)-[r:Performs|MayPerform]->(x:Action)
WHERE x.name = v AND (r.first <= t AND r.last >= t OR label(r) = 'Performs'
  AND (r.first <= t - near AND r.last >= t - near OR r.first <= t + near AND r.last >= t + near))
WITH id, n, s, count(r) AS labels,
     sum(CASE WHEN r.certain = true AND r.first <= t AND r.last >= t THEN 1 ELSE 0 END) AS sure
WHERE labels > 0 OR NOT s.listed
RETURN id, n.track AS who, sure > 0 AS certain ORDER BY id, who
