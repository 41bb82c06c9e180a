// Looks of an agent in one question, each with the people that the agent saw.
// param run: text
// param question: text
MATCH (e:Episode)-[:Made]->(o:Look)
WHERE e.id = concat($run, '/', $question)
OPTIONAL MATCH (n:Entity)-[s:Sighted]->(o)
RETURN o.number AS number, o.step AS step, o.frame AS frame, round(o.angle, 1) AS angle, o.width AS columns,
       list_sort(list_distinct(collect(n.name))) AS entities
ORDER BY number;
