// Hypotheses of one question about who the people in the plan are, likeliest first: log-odds, answer and target's box.
// param run: text
// param question: text
MATCH (e:Episode)-[:Ranks]->(h:Hypothesis)
WHERE e.id = concat($run, '/', $question)
WITH e, h
MATCH (e)-[:Holds]->(n:Entity)-[s:Sighted]->(:Observation)
WHERE n.name = h.entity AND s.current AND s.frame = h.frame
RETURN h.rank AS rank, h.entity AS entity, h.nodes AS nodes, round(h.log_odds, 2) AS log_odds, h.answer AS answer,
       CASE h.rank WHEN 1 THEN e.verdict ELSE '' END AS verdict, h.step AS step, h.frame AS frame,
       round(s.box.x, 1) AS x, round(s.box.y, 1) AS y, round(s.box.w, 1) AS w, round(s.box.h, 1) AS h, s.votes AS votes
ORDER BY rank;
