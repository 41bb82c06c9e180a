// Return the people in a frame who may perform an action. Without a label it is possible if their list was not read.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE f.id = at
OPTIONAL MATCH (n)-[r:Performs|MayPerform]->(x:Action) WHERE r.first <= t AND r.last >= t AND x.name = v
WITH id, v, n, s, count(r) AS labels, sum(CASE WHEN r.certain = true THEN 1 ELSE 0 END) AS sure
WHERE labels > 0 OR NOT s.listed
RETURN id, n.track AS who, sure > 0 AS certain ORDER BY id, who
