// change: a described person does something later that the person does not do at first.
MATCH (n:Name)-[:Describes]->(m0:Moment)<-[:At]-(p:Person)-[:At]->(m1:Moment)
WHERE n.sequence = $sequence AND m1.frame >= m0.frame + $wait AND m0.clear AND m1.clear AND m0.image AND m1.image
  AND NOT m1.ahead
// DISTINCT, because Kuzu filters the wrong rows after UNWIND of a stored list otherwise.
UNWIND m1.doing AS answer
WITH DISTINCT n.id AS name, m0.frame AS t0, m1.frame AS t1, m0.track AS a, m0.not_doing AS before, answer
WHERE list_contains(before, answer)
RETURN name, t0, t1, a, answer ORDER BY name, t1, answer
