// A line of the episode's record, accepted or refused.
MATCH (e:Episode {id: $episode})
CREATE (e)-[:Wrote]->(:Write {id: $id, episode: $episode, number: $number, step: $step, tool: $tool, arguments: $arguments, accepted: $accepted, reason: $reason})
