// Return the people in a frame at a distance that a word may name. Near a bound, two words may name it.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.v AS v
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND NOT s.covered
WITH id, v, n.track AS who, s.distance_word AS word, s.distance_word_other AS other
WHERE word IS NULL OR word = v OR other = v
RETURN id, who, coalesce(word = v AND other IS NULL, false) AS certain ORDER BY id, who
