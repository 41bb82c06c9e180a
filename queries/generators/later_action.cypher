// later_action: two relations lead to a person who does something at least ten seconds later, but not at first.
MATCH (n:Name)-[:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)
      <-[:At]-(p:Person)-[:At]->(m1:Moment)-[:Doing]->(x:Action) WHERE b.sequence = $sequence AND c.id <> a.id
  AND m1.frame >= c.frame + $later AND a.clear AND b.clear AND c.clear AND m1.clear AND a.image AND m1.image
  AND NOT m1.ahead AND list_contains(c.not_doing, x.name)
RETURN n.id AS name, a.frame AS t0, m1.frame AS t1, a.track AS a, b.track AS b, c.track AS c, s1.relation AS r1,
       s2.relation AS r2, x.name AS answer ORDER BY name, t1, r1, r2, answer
