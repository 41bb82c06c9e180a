// Create the edges from an episode to the looks whose people were listed.
MATCH (e:Episode {id: $episode})
UNWIND $rows AS r
WITH r, e
MATCH (o:Look {episode_hash: UUID($hash)})
WITH r, e, o
WHERE o.number = r.target_number
CREATE (e)-[:Listed {episode: $episode, write: r.write, step: r.step, frame: r.frame}]->(o)
