// Create the sighting edges that link entities to observations. Match nodes by the hash of the episode and filter
// them by number, because the engine does not look up the key of a node by the value of a row.
MATCH (n:Entity {episode_hash: UUID($hash)})
UNWIND $rows AS r
WITH r, n
WHERE n.number = r.source_number
MATCH (o:Observation {episode_hash: UUID($hash)})
WITH r, n, o
WHERE o.number = r.target_number
CREATE (n)-[:Sighted {episode: $episode, write: r.write, step: r.step, votes: r.votes, against: r.against, origin: r.origin, frame: r.frame, box: {x: r.x, y: r.y, w: r.w, h: r.h}, angle: r.angle, current: r.current, until: r.until, who: r.who}]->(o)
