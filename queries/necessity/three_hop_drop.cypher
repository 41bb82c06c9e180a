// time.drop of three_hop: at how many keyframes the program has an answer, and how many different ones.
// By description and relations.
// param sequence: text
MATCH (p:Description)-[f:Fits]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)-[s3:Leads]->(d:Moment)
WHERE p.id >= $low AND p.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND d.id >= $low AND d.id < $high
  AND c.id <> a.id AND d.id <> a.id AND d.id <> b.id AND d.pose IS NOT NULL
HINT (((((((p JOIN f) JOIN a) JOIN s1) JOIN b) JOIN s2) JOIN c) JOIN s3) JOIN d
RETURN p.id - $low AS description, s1.relation AS r1, s2.relation AS r2, s3.relation AS r3, count(*) AS defined,
       count(DISTINCT d.pose) AS answers
ORDER BY description, r1, r2, r3
