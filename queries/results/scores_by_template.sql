-- Scores of each run in each template, in percent of the n questions.
SELECT run_id, template, count(*) AS n,
       round_even(100 * sum(answer_score) / n, 2) AS answer,
       round_even(100 * sum(evidence_score) / n, 2) AS evidence,
       round_even(100 * sum(combined_score) / n, 2) AS combined,
       round_even(100 * sum(answer_score - combined_score) / nullif(sum(answer_score), 0), 2) AS hallucination,
       round_even(100 * sum(invalid::INT) / n, 2) AS invalid
FROM scores
JOIN questions USING (question_id)
GROUP BY ALL
ORDER BY run_id, template;
