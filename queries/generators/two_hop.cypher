// two_hop: two relations lead from a described person to another one, who does something that the others do not do.
MATCH (n:Name)-[:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)
WHERE n.sequence = $sequence AND n.general AND c.id <> a.id AND a.clear AND b.clear AND c.clear AND a.image
  AND NOT c.ahead
// DISTINCT, because Kuzu filters the wrong rows after UNWIND of a stored list otherwise.
UNWIND c.doing AS answer
WITH DISTINCT n.id AS name, a.frame AS t0, a.track AS a, b.track AS b, c.track AS c, s1.relation AS r1,
     s2.relation AS r2, a.not_doing AS not_a, b.not_doing AS not_b, answer
WHERE list_contains(not_a, answer) AND list_contains(not_b, answer)
RETURN name, t0, a, b, c, r1, r2, answer ORDER BY name, r1, r2, answer
