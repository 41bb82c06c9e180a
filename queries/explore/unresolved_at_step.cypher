// Parts of its plan that an agent had not resolved in one question at a step.
// These are nodes without a person, and conditions and edges without a belief that supports them.
// Mutual relations hold in both directions, but a direction seen from one person does not.
// The person of a node is the one at the end of the episode.
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
