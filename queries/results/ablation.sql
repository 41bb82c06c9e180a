-- Scores of the reference agent, in percent, by two settings: own choice of looks, and world model.
WITH cells (method, active, world_model) AS (
    VALUES ('agent-passive-no-world', 'off', 'off'), ('agent-passive', 'off', 'on'),
           ('agent-no-world', 'on', 'off'), ('agent', 'on', 'on')
)
SELECT active, world_model, run_id, model, if(synthetic, 'synthetic', '') AS label, count(*) AS n,
       round_even(100 * sum(answer_score) / n, 2) AS answer,
       round_even(100 * sum(evidence_score) / n, 2) AS evidence,
       round_even(100 * sum(combined_score) / n, 2) AS combined,
       round_even(100 * sum(answer_score - combined_score) / nullif(sum(answer_score), 0), 2) AS hallucination,
       round_even(100 * sum(invalid::INT) / n, 2) AS invalid
FROM scores
JOIN runs USING (run_id)
JOIN cells USING (method)
GROUP BY ALL
ORDER BY model, active, world_model, run_id;
