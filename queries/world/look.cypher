// Create the looks of an episode: crops and panoramas.
MATCH (e:Episode {id: $episode})
UNWIND $rows AS r
CREATE (e)-[:Made]->(:Look {id: r.id, episode: r.episode, number: r.number, step: r.step, frame: r.frame, angle: r.angle, left: r.left, width: r.width, episode_hash: UUID($hash)})
