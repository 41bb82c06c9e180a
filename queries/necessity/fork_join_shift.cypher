// time.shift of fork_join: description and both first steps read anew, $by frames later. Whom the people reached single
// out together is read from the joins.
MATCH (p:Path)-[:Of]->(:Description)-[f:Fits]->(a:Moment)-[s1:Step]->(b:Moment), (a)-[s2:Step]->(c:Moment)
WHERE f.t = p.t + $by AND s1.relation = p.r1 AND s2.relation = p.r2
RETURN p.id AS id, a.id AS a, b.id AS b, c.id AS c
ORDER BY id
