// fork_join: two steps lead from somebody described to two different people, and a relation of each of them singles out
// a fourth person, whose pose is asked. The branch whose first relation comes first by its text is named first.
MATCH (:Description)-[n:Names]->(a:Moment)-[s1:Leads]->(b:Moment)-[j:Joined]->(d:Moment), (a)-[s2:Leads]->(c:Moment)
WHERE n.general AND s1.relation < s2.relation AND j.a = a.id AND j.c = c.id AND d.pose IS NOT NULL
RETURN n.id AS name, a.id AS at0, s1.relation AS r1, b.id AS b, s2.relation AS r2, c.id AS c,
       j.r3 AS r3, j.r4 AS r4, d.id AS d,
       d.pose AS answer,
       n.anchor AS anchor,
       a.clear AND b.clear AND c.clear AND d.clear AS evidence,
       a.image AS image,
       d.ahead AS ahead
ORDER BY name, r1, r2, r3, r4
