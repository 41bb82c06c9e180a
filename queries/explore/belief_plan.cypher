// Support of each part of a question's plan by each person or pair of people, in log-odds, after a given step.
// The support is the sum of the readings, as the agent's bindings use it. A reading counts half for each second from the
// part's frame. Readings of frames other than the nearest one count repeats. The kind presence is evidence against
// people who are missing from looks that should show them. If the frame is null, the part holds at every frame.
// param run: text
// param question: text
// param step: integer = 10000000
// param repeats: number = 0.25
MATCH (e:Episode)-[:Asks]->(s:Slot)
WHERE e.id = concat($run, '/', $question) AND s.kind = 'entity' AND s.step <= $step
WITH e, max(s.number) AS newest
MATCH (e)-[:Asks]->(s:Slot), (e)-[:Holds]->(n:Entity)-[r:Has|Related]->(m:Look:Entity)
WHERE s.number > newest AND s.step <= $step AND r.step <= $step
  AND (s.origin = r.origin OR (s.origin = 'model' AND r.origin = 'relation'))
  AND ((s.kind <> 'edge' AND label(r) = 'Has' AND s.topic = r.topic) OR (s.kind = 'edge' AND label(r) = 'Related'
       AND s.name = r.name AND (s.origin = 'model' OR s.frame = r.frame)))
WITH s, r.frame AS frame, r.write AS written, r.origin AS origin,
     CASE label(r) WHEN 'Has' THEN m.number ELSE 0 END AS look,
     CASE label(r) WHEN 'Has' THEN n.name
          ELSE CASE WHEN s.origin = 'model' AND n.name > m.name THEN m.name ELSE n.name END END AS entity,
     CASE label(r) WHEN 'Has' THEN ''
          ELSE CASE WHEN s.origin = 'model' AND n.name > m.name THEN n.name ELSE m.name END END AS other_entity,
     CASE WHEN label(r) = 'Related' OR r.value = s.value THEN r.weight
          WHEN r.exclusive = true AND r.weight > 0 AND NOT list_contains(string_split(s.also, '|'), r.value) THEN -r.weight
          ELSE 0.0 END AS vote
WITH s, entity, other_entity, frame, look, origin, min(written) AS first, sum(vote) AS total, max(vote) AS most,
     min(vote) AS least
WITH s, entity, other_entity, frame, min(first) AS first,
     sum(CASE WHEN origin <> 'model' OR s.kind = 'edge' THEN total ELSE CASE WHEN most > 0 THEN most ELSE 0.0 END
                                                     + CASE WHEN least < 0 THEN least ELSE 0.0 END END) AS weight
WITH s, entity, other_entity,
     min(CASE WHEN s.frame < 0 THEN first WHEN frame > s.frame THEN 2 * (frame - s.frame) + 1
              ELSE 2 * (s.frame - frame) END) AS nearest,
     collect({frame: frame, first: first, weight: weight}) AS votes
UNWIND votes AS vote
WITH s, entity, other_entity, nearest, vote.frame AS frame, vote.first AS first, vote.weight AS weight
WITH s, entity, other_entity,
     sum(weight * CASE WHEN s.frame < 0 THEN CASE WHEN first = nearest THEN 1.0 ELSE $repeats END
                       WHEN 2 * abs(frame - s.frame) = nearest - nearest % 2 AND (frame > s.frame) = (nearest % 2 = 1)
                       THEN pow(0.5, abs(frame - s.frame) / 15.0)
                       ELSE $repeats * pow(0.5, abs(frame - s.frame) / 15.0) END) AS total
RETURN s.number AS part, s.kind AS kind, s.node AS node, s.other AS other, s.name AS name, s.value AS value,
       CASE WHEN s.frame < 0 THEN NULL ELSE s.frame END AS frame, entity, other_entity,
       CASE WHEN total > 3.2958 THEN 3.2958 WHEN total < -3.2958 THEN -3.2958 ELSE round(total, 4) END AS support
ORDER BY part, entity, other_entity;
