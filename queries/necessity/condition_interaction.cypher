// Return the people in a frame who may interact with another one: by a label, or if one of both lists was not read.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v
MATCH (:Person)-[z:SeenIn]->(f:Frame) WHERE f.id = at
WITH id, at, t, v, count(*) AS people, min(z.interactions_listed) AS listed
MATCH (n:Person)-[:SeenIn]->(f:Frame) WHERE f.id = at
OPTIONAL MATCH (n)-[r:Interacts|MayInteract]->(m:Person) WHERE r.label = v AND r.first <= t AND r.last >= t
WITH id, at, people, listed, n, m, r.certain AS certain
OPTIONAL MATCH (m)-[z:SeenIn]->(f:Frame) WHERE f.id = at
WITH id, n, people, listed, count(z) AS labels, coalesce(max(certain AND z.frame IS NOT NULL), false) AS certain
WHERE labels > 0 OR people > 1 AND NOT listed
RETURN id, n.track AS who, certain ORDER BY id, who
