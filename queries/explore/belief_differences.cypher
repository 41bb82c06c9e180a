// Attributes that only one of two runs believes of the people in a question's plan, at the end of the question.
// param run: text
// param other: text
// param question: text
MATCH (e:Episode)-[:Holds]->(n:Entity)-[r:Has]->(:Observation)
WHERE (e.id = concat($run, '/', $question) OR e.id = concat($other, '/', $question)) AND r.current AND n.node <> ''
WITH n.node AS node, r.name AS name, r.value AS value,
     CASE WHEN r.last >= 10000000 THEN NULL ELSE r.first END AS frame, collect(DISTINCT e.run) AS runs
WHERE size(runs) = 1
RETURN node, name, frame, value, runs[1] AS believed_by
ORDER BY frame, node, name, value, believed_by;
