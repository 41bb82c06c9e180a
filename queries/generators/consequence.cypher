// consequence: somebody described at t0, without a pose, keeps the posture of t0 at every keyframe for at least ten
// seconds more; at the next keyframe a stable segment of another has begun, which is asked.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(:Person)-[:Does]->(s:Segment)
WHERE n.poseless AND m0.t >= s.held_from AND s.held_to >= m0.t + $later
RETURN n.id AS name, m0.id AS at0, s.id AS segment,
       s.action AS answer,
       n.anchor AS anchor,
       m0.clear AND s.first_clear AS evidence,
       m0.image AND s.first_image AS image,
       s.first_ahead AS ahead
ORDER BY at0, segment
