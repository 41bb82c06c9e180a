// three_hop: three relations lead from a described person to another one, who does something that the others do not do.
MATCH (n:Name)-[:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)-[s3:Leads]->(d:Moment)
WHERE n.sequence = $sequence AND n.general AND c.id <> a.id AND d.id <> a.id AND d.id <> b.id AND a.clear AND b.clear
  AND c.clear AND d.clear AND a.image AND NOT d.ahead
// DISTINCT, because Kuzu filters the wrong rows after UNWIND of a stored list otherwise.
UNWIND d.doing AS answer
WITH DISTINCT n.id AS name, a.frame AS t0, a.track AS a, b.track AS b, c.track AS c, d.track AS d, s1.relation AS r1,
     s2.relation AS r2, s3.relation AS r3, a.not_doing AS not_a, b.not_doing AS not_b, c.not_doing AS not_c, answer
WHERE list_contains(not_a, answer) AND list_contains(not_b, answer) AND list_contains(not_c, answer)
RETURN name, t0, a, b, c, d, r1, r2, r3, answer ORDER BY name, r1, r2, r3, answer
