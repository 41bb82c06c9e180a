// time.drop of three_hop: every keyframe at which the program has an answer, and how many different ones there are.
MATCH (p:Path)-[:Of]->(:Description)-[:Fits]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)-[s3:Leads]->(d:Moment)
WHERE s1.relation = p.r1 AND s2.relation = p.r2 AND s3.relation = p.r3
  AND c.id <> a.id AND d.id <> a.id AND d.id <> b.id AND d.pose IS NOT NULL
RETURN p.id AS id, count(*) AS defined, count(DISTINCT d.pose) AS answers
ORDER BY id
