// Current beliefs of one question about each part of its plan: the entity, and the votes for and against the belief.
// A mutual relation is listed only in the direction that the agent wrote. If the frame of a belief is null, the belief
// holds at every frame.
// param run: text
// param question: text
MATCH (e:Episode)-[:Asks]->(s:Slot), (e)-[:Holds]->(n:Entity)-[r:Has|Related]->(m:Observation:Entity)
WHERE e.id = concat($run, '/', $question) AND r.current AND r.name = s.name
  AND ((s.kind = 'condition' AND label(r) = 'Has' AND r.value = s.value) OR (s.kind = 'edge' AND label(r) = 'Related'))
  AND (s.frame < 0 OR (r.first <= s.frame AND s.frame <= r.last))
RETURN s.number AS part, s.node AS node, s.other AS other, s.name AS name, s.value AS value,
       n.name AS entity, CASE label(r) WHEN 'Related' THEN m.name ELSE '' END AS other_entity,
       CASE WHEN r.last >= 10000000 THEN NULL ELSE r.first END AS frame, r.votes AS votes, r.against AS against,
       r.origin AS origin
ORDER BY part, frame, votes, against, entity, other_entity, node, other, name, value, origin;
