-- Scores of each run in percent of its n questions. Hallucination is the share of right answers with a wrong box.
SELECT s.run_id, count(*) AS n,
       round_even(100 * sum(answer_score) / n, 2) AS answer,
       round_even(100 * sum(evidence_score) / n, 2) AS evidence,
       round_even(100 * sum(combined_score) / n, 2) AS combined,
       round_even(100 * sum(answer_score - combined_score) / nullif(sum(answer_score), 0), 2) AS hallucination,
       round_even(100 * sum(invalid::INT) / n, 2) AS invalid,
       round_even(100 * count(*) FILTER (status IS NULL OR status = 'error') / n, 2) AS errors
FROM scores s
LEFT JOIN predictions USING (run_id, question_id)
GROUP BY s.run_id
ORDER BY s.run_id;
