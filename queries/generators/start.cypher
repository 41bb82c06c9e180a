// start: somebody described at t0 later starts an action: the first stable segment of it after t0.
// The action is false from t0 to the segment: it is quiet since t0 at the latest.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(:Person)-[:Does]->(s:Segment)
WHERE n.general AND s.start >= m0.t + $wait AND s.quiet_from <= m0.t
RETURN n.id AS name, m0.id AS at0, s.id AS segment,
       n.anchor AS anchor,
       m0.clear AND s.first_clear AS evidence,
       m0.image AND s.first_image AS image,
       s.first_ahead AS ahead
ORDER BY at0, segment
