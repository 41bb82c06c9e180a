// The forks that lead from somebody described to two different people: those beside whom others are looked for.
MATCH (:Description)-[n:Names]->(a:Moment)-[s1:Leads]->(b:Moment), (a)-[s2:Leads]->(c:Moment)
WHERE n.general AND b.id <> c.id AND s1.relation < s2.relation
RETURN DISTINCT a.id AS a, b.id AS b, c.id AS c
ORDER BY a, b, c
