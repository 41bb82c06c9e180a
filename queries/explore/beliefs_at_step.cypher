// Attributes and relations that the readings of a question affirm after a given step, each with its frame.
// The weight is the sum of the weights of the readings of the frame, in log-odds.
// param run: text
// param question: text
// param step: integer = 10000000
MATCH (e:Episode)-[:Holds]->(n:Entity)-[r:Has|Related]->(m:Look:Entity)
WHERE e.id = concat($run, '/', $question) AND r.origin = 'model' AND r.step <= $step
WITH n.name AS entity, r.name AS name, CASE label(r) WHEN 'Has' THEN r.value ELSE m.name END AS value, r.frame AS frame,
     min(r.step) AS since, round(sum(r.weight), 9) AS weight
WHERE weight > 0
RETURN entity, name, value, frame, since, round(weight, 4) AS weight
ORDER BY frame, since, weight, entity, name, value;
