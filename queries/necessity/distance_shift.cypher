// time.shift of distance: the change of the same person's distance since t0 when t1 moves by $by frames, whatever is known at t1.
// param sequence: text
// $by: plus or minus 15 times the rule shift_s, plus where it is not passed.
// param by: integer = 45
MATCH (n:Name)-[d:Describes]->(m0:Moment)<-[e0:At]-(p:Person)-[e1:At]->(moved:Moment)
WHERE n.id >= $low AND n.id < $high
  AND m0.id >= $low AND m0.id < $high
  AND moved.id >= $low AND moved.id < $high
  AND n.general AND moved.frame >= m0.frame + $wait + $by AND m0.distance IS NOT NULL AND moved.seen IS NOT NULL
HINT (((((n JOIN d) JOIN m0) JOIN e0) JOIN p) JOIN e1) JOIN moved
WITH m0.track AS a, m0.frame AS t0, moved.frame - $by AS t1,
     CASE WHEN moved.seen = 0 THEN 'not in view'
          WHEN m0.distance - moved.distance >= $changed THEN 'closer to the robot'
          WHEN moved.distance - m0.distance >= $changed THEN 'farther from the robot'
          WHEN abs(m0.distance - moved.distance) < $same THEN 'about the same distance' END AS answer
WHERE answer IS NOT NULL
RETURN a, t0, t1, answer
ORDER BY a, t0, t1
