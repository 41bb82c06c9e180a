// What the plan asks for.
MATCH (e:Episode {id: $episode})
UNWIND $slots AS s
CREATE (e)-[:Asks]->(:Slot {id: s.id, episode: s.episode, number: s.number, kind: s.kind, node: s.node, other: s.other, name: s.name, value: s.value, frame: s.frame})
