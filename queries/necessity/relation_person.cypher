// Return the people who may have a place relative to a person: by their boxes, or if places of one of both were not read.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v, q.person AS person
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE f.id = at AND n.id = person
WITH id, t, v, n, s, f
MATCH (m:Person)-[z:SeenIn]->(f) WHERE m.id <> n.id AND NOT z.covered
OPTIONAL MATCH (n)-[r:Beside]->(m) WHERE r.label = v AND r.first <= t AND r.last >= t
WITH id, s, m, z, count(r) AS labels, sum(CASE WHEN r.certain = true THEN 1 ELSE 0 END) AS sure
WHERE labels > 0 OR NOT s.person_view_listed OR NOT z.person_view_listed
RETURN id, m.track AS who, sure > 0 AS certain ORDER BY id, who
