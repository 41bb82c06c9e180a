// Evidence of one-person slots: for each slot, entity and frame the sum of the weights for the slot's value.
// An affirmed value of an exclusive topic is evidence against the other values, except those that it may be called.
MATCH (n:Entity {episode_hash: UUID($hash)})-[h:Has]->(:Look), (s:Slot {episode_hash: UUID($hash)})
WHERE s.topic = h.topic AND h.step <= $step
  AND (s.origin = h.origin OR (s.origin = 'model' AND h.origin = 'relation'))
RETURN s.number AS slot, n.name AS entity, h.frame AS frame, min(h.write) AS first,
       sum(CASE WHEN h.value = s.value THEN h.weight
                WHEN h.exclusive = true AND h.weight > 0 AND NOT list_contains(string_split(s.also, '|'), h.value) THEN -h.weight
                ELSE 0.0 END) AS weight
ORDER BY slot, first, frame, entity
