// two_hop: two relations lead from a described person to another one, whose posture is the answer.
MATCH (n:Name)-[:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)
WHERE n.sequence = $sequence AND n.general AND c.id <> a.id AND a.clear AND b.clear AND c.clear AND a.image
  AND NOT c.ahead AND a.pose <> c.pose AND b.pose <> c.pose
RETURN n.id AS name, a.frame AS t0, a.track AS a, b.track AS b, c.track AS c, s1.relation AS r1, s2.relation AS r2,
       c.pose AS answer ORDER BY name, r1, r2
