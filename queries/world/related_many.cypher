// What joins entities in observations. The engine finds no key by a row's value, and takes longer for pairs of an episode's nodes: one end is found after the other.
UNWIND $rows AS r
MATCH (:Episode {id: $episode})-[:Holds]->(n:Entity)
WITH r, n
WHERE n.id = r.source
MATCH (:Episode {id: $episode})-[:Holds]->(m:Entity)
WITH r, n, m
WHERE m.id = r.target
CREATE (n)-[:Related {episode: r.episode, write: r.write, step: r.step, name: r.name, observation: r.observation, first: r.first, last: r.last, current: r.current, until: r.until}]->(m)
