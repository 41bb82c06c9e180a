// Create the likeliest bindings of an episode's plan.
MATCH (e:Episode {id: $episode})
UNWIND $rows AS r
CREATE (e)-[:Ranks]->(:Hypothesis {id: r.id, episode: r.episode, step: r.step, number: r.number, rank: r.rank, entity: r.entity, nodes: r.nodes, log_odds: r.log_odds, margin: r.margin, answer: r.answer, verdict: r.verdict, frame: r.frame})
