// fork_join: two relations lead from a described person to two others, who may both lead to one fourth person.
MATCH (n:Name)-[:Describes]->(a:Moment)-[s1:Leads]->(b:Moment), (a)-[s2:Leads]->(c:Moment) WHERE a.sequence = $sequence
  AND s1.relation < s2.relation AND b.id <> c.id AND a.clear AND b.clear AND c.clear AND a.image
RETURN n.id AS name, a.frame AS t0, a.track AS a, b.track AS b, c.track AS c, s1.relation AS r1, s2.relation AS r2
ORDER BY name, r1, r2
