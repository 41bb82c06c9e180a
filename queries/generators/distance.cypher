// distance: somebody described at t0 is closer, farther or as far at t1, by lidar, or has left.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(m0:Moment)<-[e0:At]-(p:Person)-[e1:At]->(m1:Moment)
WHERE n.id >= $low AND n.id < $high
  AND m0.id >= $low AND m0.id < $high
  AND m1.id >= $low AND m1.id < $high
  AND n.general AND m1.frame >= m0.frame + $wait AND m0.distance IS NOT NULL
HINT (((((n JOIN d) JOIN m0) JOIN e0) JOIN p) JOIN e1) JOIN m1
WITH n, d, m0, m1,
     CASE WHEN m1.seen = 0 THEN 'not in view'
          WHEN m0.distance - m1.distance >= $changed THEN 'closer to the robot'
          WHEN m1.distance - m0.distance >= $changed THEN 'farther from the robot'
          WHEN abs(m0.distance - m1.distance) < $same THEN 'about the same distance' END AS answer
WHERE answer IS NOT NULL
RETURN n.id - $low AS name, m0.frame AS t0, m0.track AS a, m1.frame AS t1,
       answer,
       d.anchor AS anchor,
       m0.clear AND m1.seen IS NOT NULL AS evidence,
       m0.image AND m1.image AS image,
       (answer = 'not in view' AND m0.ahead) OR (answer <> 'not in view' AND m1.ahead) AS ahead
ORDER BY a, t0, t1
