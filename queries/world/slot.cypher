// Create the slots of an episode, which are the parts of its plan.
MATCH (e:Episode {id: $episode})
UNWIND $rows AS r
CREATE (e)-[:Asks]->(:Slot {id: r.id, episode: r.episode, number: r.number, step: r.step, kind: r.kind, node: r.node, other: r.other, name: r.name, value: r.value, topic: r.topic, origin: r.origin, also: r.also, frame: r.frame, often: r.often, episode_hash: UUID($hash)})
