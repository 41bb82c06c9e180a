// Return the people in a frame who may have a gender. Words in `w` exclude it.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.v AS v, q.w AS w
MATCH (n:Person)-[s:SeenIn]->(f:Frame)
WHERE f.id = at AND NOT s.covered AND (n.gender IS NULL OR NOT list_contains(w, n.gender))
RETURN id, n.track AS who, coalesce(n.gender = v, false) AS certain ORDER BY id, who
