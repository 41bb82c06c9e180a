// Create the hypotheses of an episode about who the people in the plan are.
MATCH (e:Episode {id: $episode})
UNWIND $rows AS r
CREATE (e)-[:Ranks]->(:Hypothesis {id: r.id, episode: r.episode, step: r.step, rank: r.rank, entity: r.entity, nodes: r.nodes, log_odds: r.log_odds, answer: r.answer, frame: r.frame})
