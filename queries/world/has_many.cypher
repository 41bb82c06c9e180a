// What is seen of entities in observations. The engine finds no key by a row's value: an episode's few nodes are paired, and the pairs matched.
MATCH (n:Entity)<-[:Holds]-(e:Episode {id: $episode})-[:Made]->(o:Observation)
WHERE n.id IN $sources AND o.id IN $targets
WITH n, o
UNWIND $rows AS r
WITH n, o, r
WHERE n.id = r.source AND o.id = r.target
CREATE (n)-[:Has {episode: r.episode, write: r.write, step: r.step, name: r.name, value: r.value, number: r.number, first: r.first, last: r.last, current: r.current, until: r.until}]->(o)
