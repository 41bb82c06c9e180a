// time.shift of distance: the change of the same person's distance since t0 when t1 moves by $by frames.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(:Person)-[:`Is`]->(m1:Moment)-[s:Shift]->(moved:Moment)
WHERE n.general AND s.by = $by AND m1.t >= m0.t + $wait AND m0.distance IS NOT NULL AND moved.seen IS NOT NULL
WITH m0, m1,
     CASE WHEN moved.seen = 0 THEN 'not in view'
          WHEN m0.distance - moved.distance >= $changed THEN 'closer to the robot'
          WHEN moved.distance - m0.distance >= $changed THEN 'farther from the robot'
          WHEN abs(m0.distance - moved.distance) < $same THEN 'about the same distance' END AS answer
WHERE answer IS NOT NULL
RETURN m0.id AS at0, m1.id AS at1, answer
ORDER BY at0, at1
