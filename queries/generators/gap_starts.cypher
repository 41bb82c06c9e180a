// gap_starts: a described person later starts two different actions, which the person has not done since.
MATCH (n:Name)-[:Describes]->(m0:Moment)<-[:At]-(p:Person)-[:Acts]->(s1:Segment), (p)-[:Acts]->(s2:Segment)
WHERE n.sequence = $sequence AND n.general AND s1.action <> s2.action AND s1.quiet_from <= m0.frame AND m0.clear
  AND s1.start >= m0.frame + $wait AND s2.quiet_from <= m0.frame AND s2.start >= s1.start + $gap AND m0.image
  AND s1.first_clear AND s2.first_clear AND s1.first_image AND s2.first_image AND NOT (s1.first_ahead AND s2.first_ahead)
RETURN n.id AS name, s1.id AS segment, s2.id AS segment2, m0.frame AS t0, m0.track AS a,
       (s2.start - s1.start) / $fps AS value ORDER BY name, segment, segment2
