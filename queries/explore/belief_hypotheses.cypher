// Likeliest bindings of a question's plan after a given step, with the answer if it is about the target of the binding.
// The margin is the distance to the best binding with another target. A margin of 10000000 means that there is no other.
// param run: text
// param question: text
// param step: integer = 10000000
MATCH (e:Episode)-[:Ranks]->(h:Hypothesis)
WHERE e.id = concat($run, '/', $question) AND h.step <= $step
WITH e, max(h.number) AS last
MATCH (e)-[:Ranks]->(h:Hypothesis)
WHERE h.number = last
RETURN h.rank AS rank, h.entity AS entity, h.nodes AS nodes, round(h.log_odds, 4) AS log_odds,
       round(h.margin, 4) AS margin, h.answer AS answer, h.verdict AS verdict,
       CASE WHEN h.frame < 0 THEN NULL ELSE h.frame END AS frame, h.step AS step
ORDER BY rank;
