// Return the people with a box in a frame.
UNWIND $asked AS q WITH q.id AS id, q.at AS at
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE f.id = at
RETURN id, n.track AS who, true AS certain ORDER BY id, who
