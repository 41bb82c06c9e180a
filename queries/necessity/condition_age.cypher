// Return the people in a frame who may have an age. Words in `w` exclude it.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.v AS v, q.w AS w
MATCH (n:Person)-[s:SeenIn]->(f:Frame)
WHERE f.id = at AND NOT s.covered AND (n.age IS NULL OR NOT list_contains(w, n.age))
RETURN id, n.track AS who, coalesce(n.age = v, false) AS certain ORDER BY id, who
