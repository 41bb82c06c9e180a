// All readings of one entity's attributes in one question, with votes. The column current marks the result.
// param run: text
// param question: text
// param entity: text
MATCH (e:Episode)-[:Holds]->(n:Entity)-[h:Has]->(o:Observation)
WHERE e.id = concat($run, '/', $question) AND n.name = $entity
RETURN CASE WHEN h.last >= 10000000 THEN NULL ELSE h.first END AS frame, h.write AS written, o.number AS look,
       h.votes AS votes, h.against AS against, h.name AS name, h.value AS value, h.origin AS origin, h.current AS current
ORDER BY frame, written;
