// A new entity.
MATCH (e:Episode {id: $episode})
CREATE (e)-[:Holds]->(:Entity {id: $id, episode: $episode, name: $name, number: $number, kind: $kind, node: $node, step: $step})
