// Attributes that a model read in an episode, in the order of the writes.
MATCH (n:Entity {episode_hash: UUID($hash)})-[r:Has]->(o:Look)
WHERE r.origin = 'model' AND r.step <= $step
RETURN n.name AS entity, o.number AS look, r.name AS name, r.value AS value, r.log_odds AS log_odds, r.write AS written
ORDER BY look, written, entity, name, value
