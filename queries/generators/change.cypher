// change: somebody described at t0, without a pose, has another known pose at t1.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(m0:Moment)<-[e0:At]-(p:Person)-[e1:At]->(m1:Moment)
WHERE n.id >= $low AND n.id < $high
  AND m0.id >= $low AND m0.id < $high
  AND m1.id >= $low AND m1.id < $high
  AND n.poseless AND m1.frame >= m0.frame + $wait AND m0.pose <> m1.pose
HINT (((((n JOIN d) JOIN m0) JOIN e0) JOIN p) JOIN e1) JOIN m1
RETURN n.id - $low AS name, m0.frame AS t0, m0.track AS a, m1.frame AS t1,
       m1.pose AS answer,
       d.anchor AS anchor,
       m0.clear AND m1.clear AS evidence,
       m0.image AND m1.image AS image,
       m1.ahead AS ahead
ORDER BY a, t0, t1
