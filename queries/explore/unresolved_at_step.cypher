// Parts of the plan that an agent had not resolved after a given step of one question.
// A part is unresolved if it is a node without a person, or a condition or edge without a belief that supports it.
// A belief in a mutual relation supports both directions. A place seen from one person supports only one direction.
// The person of a node is the person that the agent had assigned at the end of the episode.
// param run: text
// param question: text
// param step: integer
MATCH (e:Episode)-[:Asks]->(s:Slot)
WHERE e.id = concat($run, '/', $question) AND s.kind <> 'read'
  AND NOT (s.kind = 'node' AND EXISTS {
        MATCH (e)-[:Holds]->(n:Entity) WHERE n.node = s.node AND n.step <= $step })
  AND NOT (s.kind = 'condition' AND EXISTS {
        MATCH (e)-[:Holds]->(n:Entity)-[r:Has]->(:Observation)
        WHERE n.node = s.node AND r.name = s.name AND r.value = s.value AND r.step <= $step AND r.until > $step
          AND (s.frame < 0 OR (r.first <= s.frame AND r.last >= s.frame)) })
  AND NOT (s.kind = 'edge' AND EXISTS {
        MATCH (e)-[:Holds]->(n:Entity)-[r:Related]->(m:Entity)
        WHERE r.name = s.name AND r.step <= $step AND r.until > $step AND ((n.node = s.node AND m.node = s.other)
          OR (n.node = s.other AND m.node = s.node AND NOT r.name CONTAINS '(robot view)' AND NOT r.name CONTAINS ','))
          AND (s.frame < 0 OR (r.first <= s.frame AND r.last >= s.frame)) })
RETURN s.number AS number, s.kind AS kind, s.node AS node, s.other AS other, s.name AS name, s.value AS value,
       CASE WHEN s.frame < 0 THEN NULL ELSE s.frame END AS frame
ORDER BY number;
