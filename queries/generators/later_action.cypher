// later_action: two relations lead to a person who does something at least ten seconds later, but not at first.
// Because of WITH, the engine joins the later times last. In another order, its joins take 300 MB on all of JRDB.
MATCH (n:Name)-[:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)<-[:At]-(p:Person)
WHERE b.sequence = $sequence AND c.id <> a.id AND a.clear AND b.clear AND c.clear AND a.image
WITH n, a, b, c, s1.relation AS r1, s2.relation AS r2, p MATCH (p)-[:At]->(m1:Moment)-[:Doing]->(x:Action)
WHERE m1.frame >= c.frame + $later AND m1.clear AND m1.image AND NOT m1.ahead AND list_contains(c.not_doing, x.name)
RETURN n.id AS name, a.frame AS t0, m1.frame AS t1, a.track AS a, b.track AS b, c.track AS c, r1, r2, x.name AS answer
       ORDER BY name, t1, r1, r2, answer
