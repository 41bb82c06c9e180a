// gap, between two starts: somebody described at t0 later starts two different actions.
// Both are quiet since t0 at the latest. The earlier start keeps the distance from t0, the later one from the first.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(m0:Moment)<-[e0:At]-(p:Person)-[e1:Acts]->(s1:Segment), (p)-[e2:Acts]->(s2:Segment)
WHERE n.id >= $low AND n.id < $high
  AND m0.id >= $low AND m0.id < $high
  AND s1.id >= $low AND s1.id < $high
  AND s2.id >= $low AND s2.id < $high
  AND n.general AND s1.action <> s2.action
  AND s1.quiet_from <= m0.frame AND s1.start >= m0.frame + $wait
  AND s2.quiet_from <= m0.frame AND s2.start >= s1.start + $gap
HINT (((((((n JOIN d) JOIN m0) JOIN e0) JOIN p) JOIN e1) JOIN s1) JOIN e2) JOIN s2
RETURN n.id - $low AS name, m0.frame AS t0, m0.track AS a, s1.id - $low AS segment, s2.id - $low AS segment2,
       (s2.start - s1.start) / $fps AS value,
       d.anchor AS anchor,
       m0.clear AND s1.first_clear AND s2.first_clear AS evidence,
       m0.image AND s1.first_image AND s2.first_image AS image,
       s1.first_ahead AND s2.first_ahead AS ahead
ORDER BY a, t0, segment, segment2
