// hop.skip of three hops: the first ($skipped = 1) or the second (2) is left out.
MATCH (p:Path)-[:`From`]->(:Moment)-[s1:Step]->(b:Moment)-[s2:Step]->(c:Moment)
WHERE s1.relation = CASE WHEN $skipped = 1 THEN p.r2 ELSE p.r1 END AND s2.relation = p.r3
RETURN p.id AS id, b.id AS b, c.id AS c
ORDER BY id
