// consequence: somebody described at t0, without a pose, keeps a pose for ten seconds, and then the next one begins.
// The pose of t0 is held at every keyframe. At the keyframe after it a stable segment of another has begun, the answer.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(m0:Moment)<-[e0:At]-(p:Person)-[e1:Acts]->(s:Segment)
WHERE n.id >= $low AND n.id < $high
  AND m0.id >= $low AND m0.id < $high
  AND s.id >= $low AND s.id < $high
  AND n.poseless AND m0.frame >= s.held_from AND s.held_to >= m0.frame + $later
HINT (((((n JOIN d) JOIN m0) JOIN e0) JOIN p) JOIN e1) JOIN s
RETURN n.id - $low AS name, m0.frame AS t0, m0.track AS a, s.id - $low AS segment,
       s.action AS answer,
       d.anchor AS anchor,
       m0.clear AND s.first_clear AS evidence,
       m0.image AND s.first_image AS image,
       s.first_ahead AS ahead
ORDER BY a, t0, segment
