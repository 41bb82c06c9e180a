// gap_starts: a described person later starts two actions. Each is false from the description to its start.
MATCH (n:Name)-[:Describes]->(m0:Moment)<-[:At]-(p:Person)-[:Acts]->(s:Segment), (p)-[:Acts]->(u:Segment)
WHERE p.sequence = $sequence AND n.general AND s.action <> u.action AND s.quiet_from <= m0.frame AND m0.clear
  AND s.start >= m0.frame + $wait AND u.quiet_from <= m0.frame AND u.start >= s.start + $gap AND m0.image
  AND s.first_clear AND u.first_clear AND s.first_image AND u.first_image AND NOT (s.first_ahead AND u.first_ahead)
RETURN n.id AS name, s.id AS segment, u.id AS segment2, m0.frame AS t0, m0.track AS a,
       (u.start - s.start) / $fps AS value ORDER BY name, segment, segment2
