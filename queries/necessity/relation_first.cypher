// Return who may be the first person at one side of a person, as the robot sees them.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v, q.person AS person
MATCH (n:Person)-[r:Beside]->(m:Person)
WHERE n.id = person AND r.label = v AND r.first <= t AND r.last >= t
WITH id, at, m.id AS other, m.track AS who, r.certain AS certain
MATCH (m:Person)-[z:SeenIn]->(f:Frame) WHERE f.id = at AND m.id = other AND NOT z.covered
RETURN id, who, max(CASE WHEN certain = true THEN 1 ELSE 0 END) > 0 AS certain ORDER BY id, who
