// Return the action labels of a person who is not covered, whether each is easy or medium, and whether a list was read.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.person AS person
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND n.id = person AND NOT s.covered
OPTIONAL MATCH (n)-[r:Performs]->(x:Action) WHERE r.first <= t AND r.last >= t
RETURN id, s.listed AS listed, x.name AS label, coalesce(r.difficulty < 3, false) AS easy ORDER BY id, label
