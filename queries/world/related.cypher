// What joins two entities in an observation.
MATCH (n:Entity {id: $source}), (m:Entity {id: $target})
CREATE (n)-[:Related {episode: $episode, write: $write, step: $step, name: $name, observation: $observation, first: $first, last: $last, current: $current, until: $until, who: $who, whom: $whom}]->(m)
