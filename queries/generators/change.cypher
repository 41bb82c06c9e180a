// change: a described person does something later that the person does not do at first.
MATCH (n:Name)-[:Describes]->(m0:Moment)<-[:At]-(p:Person)-[:At]->(m1:Moment)-[:Doing]->(x:Action)
WHERE m1.sequence = $sequence AND m1.frame >= m0.frame + $wait AND m0.clear AND m1.clear AND m0.image AND m1.image
  AND NOT m1.ahead AND list_contains(m0.not_doing, x.name)
RETURN n.id AS name, m0.frame AS t0, m1.frame AS t1, m0.track AS a, x.name AS answer ORDER BY name, t1, answer
