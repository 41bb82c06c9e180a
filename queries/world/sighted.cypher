// Create the sighting edges from entities to looks.
// Match nodes by the hash of the episode and filter them by number, because the engine does not look up the key of a
// node by the value of a row.
MATCH (n:Entity {episode_hash: UUID($hash)})
UNWIND $rows AS r
WITH r, n
WHERE n.number = r.source_number
MATCH (o:Look {episode_hash: UUID($hash)})
WITH r, n, o
WHERE o.number = r.target_number
CREATE (n)-[:Sighted {episode: $episode, write: r.write, step: r.step, frame: r.frame, box: {x: r.x, y: r.y, w: r.w, h: r.h}, angle: r.angle, whole: r.whole, number: r.number, metres: r.metres}]->(o)
