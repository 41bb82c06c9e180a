// All readings of one person's attributes in one question, and what follows from them, after a given step.
// The log-odds of a reading are positive if the value was affirmed. The weight is what the reading adds.
// param run: text
// param question: text
// param entity: text
// param step: integer = 10000000
MATCH (e:Episode)-[:Holds]->(n:Entity)-[h:Has]->(o:Look)
WHERE e.id = concat($run, '/', $question) AND n.name = $entity AND h.name <> 'entity' AND h.step <= $step
RETURN h.write AS written, h.step AS step, o.number AS look, CASE WHEN h.frame < 0 THEN NULL ELSE h.frame END AS frame,
       h.name AS name, h.value AS value, round(h.log_odds, 4) AS log_odds, round(h.weight, 4) AS weight,
       h.origin AS origin
ORDER BY written, frame, log_odds, weight, name, value, origin;
