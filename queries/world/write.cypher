// Lines of the episode's record, accepted or refused.
MATCH (e:Episode {id: $episode})
UNWIND $writes AS w
CREATE (e)-[:Wrote]->(:Write {id: w.id, episode: $episode, number: w.number, step: w.step, tool: w.tool, arguments: w.arguments, accepted: w.accepted, reason: w.reason})
