// Return the people in a frame at a distance that a word may name. Near a bound, two words may name it.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.v AS v
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND NOT s.covered
  AND (s.distance_word IS NULL OR s.distance_word = v OR s.distance_word_other = v)
RETURN id, n.track AS who, coalesce(s.distance_word = v AND s.distance_word_other IS NULL, false) AS certain
ORDER BY id, who
