// consequence: a described person keeps a posture for ten seconds, then the next one begins.
MATCH (n:Name)-[:Describes]->(m0:Moment)<-[:At]-(p:Person)-[:Acts]->(s:Segment)
WHERE p.sequence = $sequence AND m0.frame >= s.held_from AND s.held_to >= m0.frame + $later AND m0.clear
  AND s.first_clear AND m0.image AND s.first_image AND NOT s.first_ahead
RETURN n.id AS name, s.id AS segment, m0.frame AS t0, m0.track AS a, s.action AS answer ORDER BY name, segment
