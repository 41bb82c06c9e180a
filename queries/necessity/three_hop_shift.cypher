// time.shift of three_hop: description and hops read anew, $by frames later.
MATCH (p:Path)-[:Of]->(:Description)-[f:Fits]->(a:Moment)-[s1:Step]->(b:Moment)-[s2:Step]->(c:Moment)-[s3:Step]->(d:Moment)
WHERE f.t = p.t + $by AND s1.relation = p.r1 AND s2.relation = p.r2 AND s3.relation = p.r3
RETURN p.id AS id, a.id AS a, b.id AS b, c.id AS c, d.id AS d
ORDER BY id
