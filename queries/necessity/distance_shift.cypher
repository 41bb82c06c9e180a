// time.shift of distance: the change of the same person's distance since t0 when t1 moves by $by frames.
// param sequence: text
// $by: plus or minus 15 times the rule shift_s, plus where it is not passed. Any other number finds no rows.
// param by: integer = 45
MATCH (n:Name)-[:Describes]->(m0:Moment)<-[:At]-(:Person)-[:At]->(m1:Moment)-[s:Shift]->(moved:Moment)
WHERE n.id >= $low AND n.id < $high
  AND m0.id >= $low AND m0.id < $high
  AND m1.id >= $low AND m1.id < $high
  AND moved.id >= $low AND moved.id < $high
  AND n.general AND s.by = $by AND m1.frame >= m0.frame + $wait AND m0.distance IS NOT NULL AND moved.seen IS NOT NULL
WITH m0, m1,
     CASE WHEN moved.seen = 0 THEN 'not in view'
          WHEN m0.distance - moved.distance >= $changed THEN 'closer to the robot'
          WHEN moved.distance - m0.distance >= $changed THEN 'farther from the robot'
          WHEN abs(m0.distance - moved.distance) < $same THEN 'about the same distance' END AS answer
WHERE answer IS NOT NULL
RETURN m0.track AS a, m0.frame AS t0, m1.frame AS t1, answer
ORDER BY a, t0, t1
