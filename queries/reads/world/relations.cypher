// Relations that a model read in an episode, in the order of the writes.
MATCH (n:Entity {episode_hash: UUID($hash)})-[r:Related]->(m:Entity)
WHERE r.origin = 'model' AND r.step <= $step
RETURN n.name AS source, m.name AS target, r.look AS look, r.name AS name, r.log_odds AS log_odds, r.write AS written
ORDER BY written, look, source, name, target
