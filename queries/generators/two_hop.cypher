// two_hop: two relations lead from a described person to another one, who does something that the others do not do.
MATCH (n:Name)-[:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)-[:Doing]->(x:Action)
WHERE b.sequence = $sequence AND c.id <> a.id AND a.clear AND b.clear AND c.clear AND a.image
  AND NOT c.ahead AND list_contains(a.not_doing, x.name) AND list_contains(b.not_doing, x.name)
RETURN n.id AS name, a.frame AS t0, a.track AS a, b.track AS b, c.track AS c, s1.relation AS r1, s2.relation AS r2,
       x.name AS answer ORDER BY name, r1, r2, answer
