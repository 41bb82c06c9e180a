-- Scores of each run in the paper's groups of families, in percent of the n questions.
-- The group chain has the families chain_2hop, chain_3hop and chain_fork_join. The group hybrid has chain_hybrid.
SELECT run_id,
       CASE WHEN family = 'chain_hybrid' THEN 'hybrid' WHEN starts_with(family, 'chain_') THEN 'chain'
            ELSE replace(family, '_', ' ') END AS "group",
       count(*) AS n,
       round_even(100 * sum(answer_score) / n, 2) AS answer,
       round_even(100 * sum(evidence_score) / n, 2) AS evidence,
       round_even(100 * sum(combined_score) / n, 2) AS combined,
       round_even(100 * sum(answer_score - combined_score) / nullif(sum(answer_score), 0), 2) AS hallucination,
       round_even(100 * sum(invalid::INT) / n, 2) AS invalid
FROM scores
JOIN questions USING (question_id)
GROUP BY ALL
ORDER BY run_id, "group";
