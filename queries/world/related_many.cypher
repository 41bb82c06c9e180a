// What joins entities in observations. The engine finds no key by a row's value: an episode's few nodes are paired, and the pairs matched.
MATCH (n:Entity)<-[:Holds]-(e:Episode {id: $episode})-[:Holds]->(m:Entity)
WHERE n.id IN $sources AND m.id IN $targets
WITH n, m
UNWIND $rows AS r
WITH n, m, r
WHERE n.id = r.source AND m.id = r.target
CREATE (n)-[:Related {episode: r.episode, write: r.write, step: r.step, name: r.name, observation: r.observation, first: r.first, last: r.last, current: r.current, until: r.until}]->(m)
