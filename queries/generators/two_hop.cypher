// two_hop: two certain steps from somebody described lead to a person whose pose is asked.
MATCH (:Description)-[n:Names]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)
WHERE n.general AND c.id <> a.id AND c.pose IS NOT NULL
RETURN n.id AS name, a.id AS at0, s1.relation AS r1, b.id AS b, s2.relation AS r2, c.id AS c,
       c.pose AS answer,
       n.anchor AS anchor,
       a.clear AND b.clear AND c.clear AS evidence,
       a.image AS image,
       c.ahead AS ahead
ORDER BY name, r1, r2
