// Attributes and relations that an agent believed in one question after a given step, each with its frame.
// param run: text
// param question: text
// param step: integer
MATCH (e:Episode)-[:Holds]->(n:Entity)-[r:Has|:Related]->(o:Observation:Entity)
WHERE e.id = concat($run, '/', $question) AND r.step <= $step AND r.until > $step
RETURN n.name AS entity, r.name AS name, CASE label(r) WHEN 'Has' THEN r.value ELSE o.name END AS value,
       CASE WHEN r.last >= 10000000 THEN NULL ELSE r.first END AS frame, r.step AS since
ORDER BY frame, since, entity, name, value;
