// Create relations of entities in observations. (The engine does not look up a key by a row's value.)
MATCH (n:Entity {episode_hash: UUID($hash)})
UNWIND $rows AS r
WITH r, n
WHERE n.number = r.source_number
MATCH (m:Entity {episode_hash: UUID($hash)})
WITH r, n, m
WHERE m.number = r.target_number
CREATE (n)-[:Related {episode: $episode, write: r.write, step: r.step, votes: r.votes, against: r.against, origin: r.origin, name: r.name, observation: r.observation, first: r.first, last: r.last, current: r.current, until: r.until, who: r.who, whom: r.whom}]->(m)
