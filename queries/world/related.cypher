// Create the relation edges between entities.
// Match nodes by the hash of the episode and filter them by number, because the engine does not look up the key of a
// node by the value of a row.
MATCH (n:Entity {episode_hash: UUID($hash)})
UNWIND $rows AS r
WITH r, n
WHERE n.number = r.source_number
MATCH (m:Entity {episode_hash: UUID($hash)})
WITH r, n, m
WHERE m.number = r.target_number
CREATE (n)-[:Related {episode: $episode, write: r.write, step: r.step, frame: r.frame, name: r.name, log_odds: r.log_odds, weight: r.weight, look: r.look, origin: r.origin}]->(m)
