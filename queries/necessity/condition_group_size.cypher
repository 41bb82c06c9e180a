// Return the people in a frame who may be in a group of a size.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.v AS v
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND NOT s.covered
  AND (s.group_size_min IS NULL OR s.group_size_min <= v AND s.group_size_max >= v)
RETURN id, n.track AS who, coalesce(s.group_size_min = v AND s.group_size_max = v, false) AS certain ORDER BY id, who
