// Create the nodes of an episode's writes, both accepted and refused.
MATCH (e:Episode {id: $episode})
UNWIND $rows AS r
CREATE (e)-[:Wrote]->(:Write {id: r.id, episode: $episode, number: r.number, step: r.step, tool: r.tool, arguments: r.arguments, accepted: r.accepted, reason: r.reason})
