// time.drop of three_hop: every keyframe at which the program has an answer, and how many different ones there are.
// Each WITH keeps the walk in order, from the paths on: else every chain of the scene may be laid out first.
MATCH (p:Path)-[:Of]->(:Description)-[:Fits]->(a:Moment)
WITH p, a
MATCH (a)-[s1:Leads]->(b:Moment)
WHERE s1.relation = p.r1
WITH p, a, b
MATCH (b)-[s2:Leads]->(c:Moment)
WHERE s2.relation = p.r2 AND c.id <> a.id
WITH p, a, b, c
MATCH (c)-[s3:Leads]->(d:Moment)
WHERE s3.relation = p.r3 AND d.id <> a.id AND d.id <> b.id AND d.pose IS NOT NULL
RETURN p.id AS id, count(*) AS defined, count(DISTINCT d.pose) AS answers
ORDER BY id
