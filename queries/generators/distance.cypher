// distance: somebody described at t0 is closer, farther or as far at t1, by lidar, or has left.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(:Person)-[:`Is`]->(m1:Moment)
WHERE n.general AND m1.t >= m0.t + $wait AND m0.distance IS NOT NULL
WITH n, m0, m1,
     CASE WHEN m1.seen = 0 THEN 'not in view'
          WHEN m0.distance - m1.distance >= $changed THEN 'closer to the robot'
          WHEN m1.distance - m0.distance >= $changed THEN 'farther from the robot'
          WHEN abs(m0.distance - m1.distance) < $same THEN 'about the same distance' END AS answer
WHERE answer IS NOT NULL
RETURN n.id AS name, m0.id AS at0, m1.id AS at1,
       answer,
       n.anchor AS anchor,
       m0.clear AND m1.seen IS NOT NULL AS evidence,
       m0.image AND m1.image AS image,
       (answer = 'not in view' AND m0.ahead) OR (answer <> 'not in view' AND m1.ahead) AS ahead
ORDER BY at0, at1
