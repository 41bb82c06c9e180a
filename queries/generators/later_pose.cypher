// later_pose: two relations lead to a person whose posture ten seconds later or more is another one.
MATCH (n:Name)-[:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)
      <-[:At]-(p:Person)-[:At]->(m1:Moment)
WHERE n.sequence = $sequence AND n.general AND c.id <> a.id AND m1.frame >= c.frame + $later AND m1.pose <> c.pose
  AND a.clear AND b.clear AND c.clear AND m1.clear AND a.image AND m1.image AND NOT m1.ahead
RETURN n.id AS name, a.frame AS t0, m1.frame AS t1, a.track AS a, b.track AS b, c.track AS c, s1.relation AS r1,
       s2.relation AS r2, m1.pose AS answer ORDER BY name, t1, r1, r2
