// Return the people in a frame who may have a posture. A closed gap leaves it possible beside another posture.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND NOT s.covered
OPTIONAL MATCH (n)-[r:Performs|MayPerform]->(x:Action) WHERE r.first <= t AND r.last >= t AND x.name = v
WITH id, v, n, s, count(r) AS labels WHERE labels > 0 OR s.pose IS NULL OR s.pose = v
RETURN id, n.track AS who, coalesce(s.pose = v, false) AS certain ORDER BY id, who
