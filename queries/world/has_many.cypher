// What is seen of entities in observations. The engine finds no key by a row's value, and takes longer for pairs of an episode's nodes: one end is found after the other.
UNWIND $rows AS r
MATCH (:Episode {id: $episode})-[:Holds]->(n:Entity)
WITH r, n
WHERE n.id = r.source
MATCH (:Episode {id: $episode})-[:Made]->(o:Observation)
WITH r, n, o
WHERE o.id = r.target
CREATE (n)-[:Has {episode: r.episode, write: r.write, step: r.step, name: r.name, value: r.value, number: r.number, first: r.first, last: r.last, current: r.current, until: r.until}]->(o)
