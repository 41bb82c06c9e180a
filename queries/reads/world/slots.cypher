// Evidence of one-person slots: for each slot, entity and frame the sum of the weights for the slot's value.
// An affirmed value of an exclusive topic is evidence against the other values, except those that it may be called.
// Labels of one reading that contradict each other cancel out. Labels that agree count as one.
MATCH (n:Entity {episode_hash: UUID($hash)})-[h:Has]->(o:Look), (s:Slot {episode_hash: UUID($hash)})
WHERE s.topic = h.topic AND h.step <= $step
  AND (s.origin = h.origin OR (s.origin = 'model' AND h.origin = 'relation'))
WITH s.number AS slot, n.name AS entity, h.frame AS frame, h.write AS written, o.number AS look, h.origin AS origin,
     CASE WHEN h.value = s.value THEN h.weight
          WHEN h.exclusive = true AND h.weight > 0 AND NOT list_contains(string_split(s.also, '|'), h.value) THEN -h.weight
          ELSE 0.0 END AS vote
WITH slot, entity, frame, look, origin, min(written) AS first, sum(vote) AS total, max(vote) AS most, min(vote) AS least
RETURN slot, entity, frame, min(first) AS first,
       sum(CASE WHEN origin <> 'model' THEN total ELSE CASE WHEN most > 0 THEN most ELSE 0.0 END
                                                     + CASE WHEN least < 0 THEN least ELSE 0.0 END END) AS weight
ORDER BY slot, first, frame, entity
