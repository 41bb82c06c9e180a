// time.drop of fork_join: the two people reached at every keyframe at which there are two.
MATCH (p:Path)-[:Of]->(:Description)-[f:Fits]->(a:Moment)-[s1:Leads]->(b:Moment), (a)-[s2:Leads]->(c:Moment)
WHERE s1.relation = p.r1 AND s2.relation = p.r2 AND b.id <> c.id
RETURN p.id AS id, f.t AS t, a.id AS a, b.id AS b, c.id AS c
ORDER BY id, t
