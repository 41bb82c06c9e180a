// change: a person who is described without a posture has another posture later.
MATCH (n:Name)-[:Describes]->(m0:Moment)<-[:At]-(p:Person)-[:At]->(m1:Moment)
WHERE n.sequence = $sequence AND n.poseless AND m1.frame >= m0.frame + $wait AND m0.pose <> m1.pose
  AND m0.clear AND m1.clear AND m0.image AND m1.image AND NOT m1.ahead
RETURN n.id AS name, m0.frame AS t0, m1.frame AS t1, m0.track AS a, m1.pose AS answer ORDER BY name, t1
