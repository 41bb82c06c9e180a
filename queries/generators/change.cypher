// change: somebody described at t0, without a pose, has another pose at t1; both poses are known.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(:Person)-[:`Is`]->(m1:Moment)
WHERE n.poseless AND m1.t >= m0.t + $wait AND m0.pose <> m1.pose
RETURN n.id AS name, m0.id AS at0, m1.id AS at1,
       m1.pose AS answer,
       n.anchor AS anchor,
       m0.clear AND m1.clear AS evidence,
       m0.image AND m1.image AS image,
       m1.ahead AS ahead
ORDER BY at0, at1
