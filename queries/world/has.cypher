// Create the attribute edges from entities to looks.
// Match nodes by the hash of the episode and filter them by number, because the engine does not look up the key of a
// node by the value of a row.
MATCH (n:Entity {episode_hash: UUID($hash)})
UNWIND $rows AS r
WITH r, n
WHERE n.number = r.source_number
MATCH (o:Look {episode_hash: UUID($hash)})
WITH r, n, o
WHERE o.number = r.target_number
CREATE (n)-[:Has {episode: $episode, write: r.write, step: r.step, frame: r.frame, topic: r.topic, name: r.name, value: r.value, log_odds: r.log_odds, weight: r.weight, exclusive: r.exclusive, origin: r.origin}]->(o)
