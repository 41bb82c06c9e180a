// span: as start, for segments that also have a clean end.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(:Person)-[:Does]->(s:Segment)
WHERE n.general AND s.closed AND s.start >= m0.t + $wait AND s.quiet_from <= m0.t
RETURN n.id AS name, m0.id AS at0, s.id AS segment,
       n.anchor AS anchor,
       m0.clear AND s.first_clear AND s.last_clear AS evidence,
       m0.image AND s.first_image AND s.last_image AS image,
       s.first_ahead AND s.last_ahead AS ahead
ORDER BY at0, segment
