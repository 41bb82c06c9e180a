// later_pose: two steps lead to a person at t0 whose pose at t1, at least ten seconds later, is another one.
MATCH (:Description)-[n:Names]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)<-[:`Is`]-(:Person)
      -[:`Is`]->(m1:Moment)
WHERE n.general AND c.id <> a.id
  AND m1.t >= c.t + $later AND m1.pose <> c.pose
RETURN n.id AS name, a.id AS at0, s1.relation AS r1, b.id AS b, s2.relation AS r2, c.id AS c, m1.id AS at1,
       m1.pose AS answer,
       n.anchor AS anchor,
       a.clear AND b.clear AND c.clear AND m1.clear AS evidence,
       a.image AND m1.image AS image,
       m1.ahead AS ahead
ORDER BY name, r1, r2, at1
