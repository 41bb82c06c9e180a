// Return the people in a frame who have a box and are not covered.
UNWIND $asked AS q WITH q.id AS id, q.at AS at
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND NOT s.covered
RETURN id, n.track AS who, true AS certain ORDER BY id, who
