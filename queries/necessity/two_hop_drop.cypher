// time.drop of two_hop: every keyframe at which the program has an answer, and how many different ones there are.
MATCH (p:Path)-[:Of]->(:Description)-[:Fits]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)
WHERE s1.relation = p.r1 AND s2.relation = p.r2 AND c.id <> a.id AND c.pose IS NOT NULL
RETURN p.id AS id, count(*) AS defined, count(DISTINCT c.pose) AS answers
ORDER BY id
