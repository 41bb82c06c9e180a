// later_pose: two steps lead to a person at t0 whose pose at t1, at least ten seconds later, is another one.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)<-[e0:At]-(p:Person)
      -[e1:At]->(m1:Moment)
WHERE n.id >= $low AND n.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND m1.id >= $low AND m1.id < $high
  AND n.general AND c.id <> a.id
  AND m1.frame >= c.frame + $later AND m1.pose <> c.pose
HINT (((((((((n JOIN d) JOIN a) JOIN s1) JOIN b) JOIN s2) JOIN c) JOIN e0) JOIN p) JOIN e1) JOIN m1
RETURN n.id - $low AS name, a.frame AS t0, a.track AS a, s1.relation AS r1, b.track AS b, s2.relation AS r2,
       c.track AS c, m1.frame AS t1,
       m1.pose AS answer,
       d.anchor AS anchor,
       a.clear AND b.clear AND c.clear AND m1.clear AS evidence,
       a.image AND m1.image AS image,
       m1.ahead AS ahead
ORDER BY name, t1, r1, r2
