// Create the entities of an episode.
MATCH (e:Episode {id: $episode})
UNWIND $rows AS r
CREATE (e)-[:Holds]->(:Entity {id: r.id, episode: r.episode, name: r.name, number: r.number, step: r.step, episode_hash: UUID($hash)})
