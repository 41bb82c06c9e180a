// Return the people in a frame who may perform an action. Without a label it is possible if their list was not read.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE f.id = at
OPTIONAL MATCH (n)-[r:Performs|MayPerform]->(x:Action) WHERE r.first <= t AND r.last >= t AND x.name = v
WITH id, n, s, count(r) AS labels, coalesce(max(r.certain), false) AS certain WHERE labels > 0 OR NOT s.listed
RETURN id, n.track AS who, certain ORDER BY id, who
