// distance: a described person is closer, farther or as far later, by lidar, or has left.
MATCH (n:Name)-[:Describes]->(m0:Moment)<-[:At]-(p:Person)-[:At]->(m1:Moment)
WHERE p.sequence = $sequence AND n.general AND m1.frame >= m0.frame + $wait AND m0.distance IS NOT NULL AND m0.clear
  AND m1.seen IS NOT NULL AND m0.image AND m1.image
WITH n, m0, m1, CASE WHEN m1.seen = 0 THEN 'not in view'
                     WHEN m0.distance - m1.distance >= $changed THEN 'closer to the robot'
                     WHEN m1.distance - m0.distance >= $changed THEN 'farther from the robot'
                     WHEN abs(m0.distance - m1.distance) < $same THEN 'about the same distance' END AS answer
WHERE answer IS NOT NULL AND NOT m1.ahead AND (m1.seen = 1 OR NOT m0.ahead)
RETURN n.id AS name, m0.frame AS t0, m1.frame AS t1, m0.track AS a, answer ORDER BY name, t1
