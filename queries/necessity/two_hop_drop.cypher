// time.drop of two_hop: at how many keyframes the program has an answer, and how many different ones.
// By description and relations.
// param sequence: text
MATCH (p:Description)-[:Fits]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)
WHERE p.id >= $low AND p.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND c.id <> a.id AND c.pose IS NOT NULL
RETURN p.id - $low AS description, s1.relation AS r1, s2.relation AS r2, count(*) AS defined,
       count(DISTINCT c.pose) AS answers
ORDER BY description, r1, r2
