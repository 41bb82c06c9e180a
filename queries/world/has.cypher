// What is seen of an entity in an observation.
MATCH (n:Entity {id: $source}), (o:Observation {id: $target})
CREATE (n)-[:Has {episode: $episode, write: $write, step: $step, name: $name, value: $value, number: $number, first: $first, last: $last, current: $current, until: $until, who: $who}]->(o)
