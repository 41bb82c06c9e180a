// Where an entity is in an observation.
MATCH (n:Entity {id: $source}), (o:Observation {id: $target})
CREATE (n)-[:Sighted {episode: $episode, write: $write, step: $step, frame: $frame, box: {x: $x, y: $y, w: $w, h: $h}, angle: $angle, current: $current, until: $until, who: $who}]->(o)
