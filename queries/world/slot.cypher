// What the plan asks for: one row per node, condition and edge, and one for the read.
MATCH (e:Episode {id: $episode})
CREATE (e)-[:Asks]->(:Slot {id: $id, episode: $episode, number: $number, kind: $kind, node: $node, other: $other, name: $name, value: $value, frame: $frame})
