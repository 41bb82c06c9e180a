// Parts of the plan that the likeliest binding leaves open or contradicts after a given step of one question.
// A part is resolved if its support is positive (see belief_plan). If no person is known, no part is resolved.
// param run: text
// param question: text
// param step: integer = 10000000
// param repeats: number = 0.25
MATCH (e:Episode)-[:Ranks]->(h:Hypothesis)
WHERE e.id = concat($run, '/', $question) AND h.step <= $step
WITH e, max(h.number) AS last
MATCH (e)-[:Ranks]->(h:Hypothesis)
WHERE h.number = last AND h.rank = 1
WITH e, concat(', ', h.nodes, ',') AS bound
MATCH (e)-[:Asks]->(s:Slot)
WHERE s.kind = 'entity' AND s.step <= $step
WITH e, bound, max(s.number) AS newest
MATCH (e)-[:Asks]->(s:Slot), (e)-[:Holds]->(n:Entity)-[r:Has|Related]->(m:Look:Entity)
WHERE s.number > newest AND s.step <= $step AND r.step <= $step
  AND (s.origin = r.origin OR (s.origin = 'model' AND r.origin = 'relation'))
  AND ((s.kind = 'condition' AND label(r) = 'Has' AND s.topic = r.topic
        AND bound CONTAINS concat(', ', s.node, '=', n.name, ','))
    OR (s.kind = 'edge' AND label(r) = 'Related' AND s.name = r.name AND (s.origin = 'model' OR s.frame = r.frame)
        AND ((bound CONTAINS concat(', ', s.node, '=', n.name, ',')
              AND bound CONTAINS concat(', ', s.other, '=', m.name, ','))
          OR (s.origin = 'model' AND NOT s.name CONTAINS '(robot view)' AND NOT s.name CONTAINS ','
              AND bound CONTAINS concat(', ', s.node, '=', m.name, ',')
              AND bound CONTAINS concat(', ', s.other, '=', n.name, ',')))))
WITH s, r.frame AS frame, r.write AS written, r.origin AS origin,
     CASE label(r) WHEN 'Has' THEN m.number ELSE 0 END AS look,
     CASE WHEN label(r) = 'Related' OR r.value = s.value THEN r.weight
          WHEN r.exclusive = true AND r.weight > 0 AND NOT list_contains(string_split(s.also, '|'), r.value) THEN -r.weight
          ELSE 0.0 END AS vote
WITH s, frame, look, origin, min(written) AS first, sum(vote) AS total, max(vote) AS most, min(vote) AS least
WITH s, frame, min(first) AS first,
     sum(CASE WHEN origin <> 'model' OR s.kind = 'edge' THEN total ELSE CASE WHEN most > 0 THEN most ELSE 0.0 END
                                                     + CASE WHEN least < 0 THEN least ELSE 0.0 END END) AS weight
WITH s,
     min(CASE WHEN s.frame < 0 THEN first WHEN frame > s.frame THEN 2 * (frame - s.frame) + 1
              ELSE 2 * (s.frame - frame) END) AS nearest,
     collect({frame: frame, first: first, weight: weight}) AS votes
UNWIND votes AS vote
WITH s, nearest, vote.frame AS frame, vote.first AS first, vote.weight AS weight
WITH s,
     sum(weight * CASE WHEN s.frame < 0 THEN CASE WHEN first = nearest THEN 1.0 ELSE $repeats END
                       WHEN 2 * abs(frame - s.frame) = nearest - nearest % 2 AND (frame > s.frame) = (nearest % 2 = 1)
                       THEN pow(0.5, abs(frame - s.frame) / 15.0)
                       ELSE $repeats * pow(0.5, abs(frame - s.frame) / 15.0) END) AS total
WITH collect(CASE WHEN total > 0 THEN s.number ELSE -1 END) AS resolved
MATCH (e:Episode)-[:Asks]->(s:Slot)
WHERE e.id = concat($run, '/', $question) AND s.kind = 'entity' AND s.step <= $step
WITH e, resolved, max(s.number) AS newest
MATCH (e)-[:Asks]->(s:Slot)
WHERE (s.kind = 'condition' OR s.kind = 'edge') AND s.number > newest AND s.step <= $step
  AND NOT coalesce(list_contains(resolved, s.number), false)
RETURN s.number AS part, s.kind AS kind, s.node AS node, s.other AS other, s.name AS name, s.value AS value,
       CASE WHEN s.frame < 0 THEN NULL ELSE s.frame END AS frame
ORDER BY part;
