// Return the people in a frame who may be called by a word for a gender or an age. Labels in `w` exclude a person.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.v AS v, q.w AS w, q.kind AS kind
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND NOT s.covered
WITH id, v, w, n.track AS who, CASE kind WHEN 'age' THEN n.age ELSE n.gender END AS word
WHERE word IS NULL OR NOT list_contains(w, word) RETURN id, who, coalesce(word = v, false) AS certain ORDER BY id, who
