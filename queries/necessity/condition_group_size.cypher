// Return the people in a frame who may be in a group of a size.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.v AS v
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE f.id = at AND (s.group_size IS NULL OR s.group_size = v)
RETURN id, n.track AS who, coalesce(s.group_size = v, false) AS certain ORDER BY id, who
