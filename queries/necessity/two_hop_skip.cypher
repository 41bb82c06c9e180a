// hop.skip of two hops: the first is left out ($skipped = 1).
MATCH (p:Path)-[:`From`]->(:Moment)-[s:Step]->(b:Moment)
WHERE s.relation = p.r2 AND $skipped = 1
RETURN p.id AS id, b.id AS b
ORDER BY id
