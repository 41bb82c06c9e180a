// span: somebody described at t0 later starts an action and stops it: a stable segment with a clean end.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(m0:Moment)<-[e0:At]-(p:Person)-[e1:Acts]->(s:Segment)
WHERE n.id >= $low AND n.id < $high
  AND m0.id >= $low AND m0.id < $high
  AND s.id >= $low AND s.id < $high
  AND n.general AND s.closed AND s.start >= m0.frame + $wait AND s.quiet_from <= m0.frame
HINT (((((n JOIN d) JOIN m0) JOIN e0) JOIN p) JOIN e1) JOIN s
RETURN n.id - $low AS name, m0.frame AS t0, m0.track AS a, s.id - $low AS segment,
       d.anchor AS anchor,
       m0.clear AND s.first_clear AND s.last_clear AS evidence,
       m0.image AND s.first_image AND s.last_image AS image,
       s.first_ahead AND s.last_ahead AS ahead
ORDER BY a, t0, segment
