// Where entities are in observations. The engine finds no key by a row's value, and takes longer for pairs of an episode's nodes: one end is found after the other.
UNWIND $rows AS r
MATCH (:Episode {id: $episode})-[:Holds]->(n:Entity)
WITH r, n
WHERE n.id = r.source
MATCH (:Episode {id: $episode})-[:Made]->(o:Observation)
WITH r, n, o
WHERE o.id = r.target
CREATE (n)-[:Sighted {episode: r.episode, write: r.write, step: r.step, frame: r.frame, box: {x: r.x, y: r.y, w: r.w, h: r.h}, angle: r.angle, current: r.current, until: r.until}]->(o)
