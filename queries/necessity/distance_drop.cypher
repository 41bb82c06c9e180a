// time.drop of distance: every keyframe at which t1 could be, and how many different answers are known there.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(m0:Moment)<-[e0:At]-(p:Person)-[e1:At]->(m:Moment)
WHERE n.id >= $low AND n.id < $high
  AND m0.id >= $low AND m0.id < $high
  AND m.id >= $low AND m.id < $high
  AND n.general AND m.frame >= m0.frame + $wait AND m0.distance IS NOT NULL AND m.seen IS NOT NULL
HINT (((((n JOIN d) JOIN m0) JOIN e0) JOIN p) JOIN e1) JOIN m
WITH m0.track AS a, m0.frame AS t0,
     CASE WHEN m.seen = 0 THEN 'not in view'
          WHEN m0.distance - m.distance >= $changed THEN 'closer to the robot'
          WHEN m.distance - m0.distance >= $changed THEN 'farther from the robot'
          WHEN abs(m0.distance - m.distance) < $same THEN 'about the same distance' END AS answer
WHERE answer IS NOT NULL
RETURN a, t0, count(*) AS defined, count(DISTINCT answer) AS answers
ORDER BY a, t0
