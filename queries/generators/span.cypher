// span: a described person later starts an action and stops it.
MATCH (n:Name)-[:Describes]->(m0:Moment)<-[:At]-(p:Person)-[:Acts]->(s:Segment) WHERE p.sequence = $sequence
  AND n.general AND s.closed AND s.start >= m0.frame + $wait AND s.quiet_from <= m0.frame AND m0.clear AND m0.image
  AND s.first_clear AND s.last_clear AND s.first_image AND s.last_image AND NOT (s.first_ahead AND s.last_ahead)
RETURN n.id AS name, s.id AS segment, m0.frame AS t0, m0.track AS a ORDER BY name, segment
