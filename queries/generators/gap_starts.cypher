// gap, between two starts: somebody described at t0 later starts two different actions, each for the first time after
// t0: both are quiet since t0 at the latest. The earlier start keeps the distance from t0, the later one from the first.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(p:Person)-[:Does]->(s1:Segment), (p)-[:Does]->(s2:Segment)
WHERE n.general AND s1.action <> s2.action
  AND s1.quiet_from <= m0.t AND s1.start >= m0.t + $wait
  AND s2.quiet_from <= m0.t AND s2.start >= s1.start + $gap
RETURN n.id AS name, m0.id AS at0, s1.id AS segment, s2.id AS segment2,
       (s2.start - s1.start) / $fps AS value,
       n.anchor AS anchor,
       m0.clear AND s1.first_clear AND s2.first_clear AS evidence,
       m0.image AND s1.first_image AND s2.first_image AS image,
       s1.first_ahead AND s2.first_ahead AS ahead
ORDER BY at0, segment, segment2
