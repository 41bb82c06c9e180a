// three_hop: as two_hop, one step farther; the four are different people.
MATCH (:Description)-[n:Names]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)-[s3:Leads]->(d:Moment)
WHERE n.general AND c.id <> a.id AND d.id <> a.id AND d.id <> b.id AND d.pose IS NOT NULL
RETURN n.id AS name, a.id AS at0, s1.relation AS r1, b.id AS b, s2.relation AS r2, c.id AS c, s3.relation AS r3,
       d.id AS d,
       d.pose AS answer,
       n.anchor AS anchor,
       a.clear AND b.clear AND c.clear AND d.clear AS evidence,
       a.image AS image,
       d.ahead AS ahead
ORDER BY name, r1, r2, r3
