-- Scores of each run by the number of looks at a question, in percent of the n questions with so many looks.
SELECT p.run_id, p.n_observations AS looks, count(*) AS n,
       round(100 * avg(s.answer_score), 2) AS answer,
       round(100 * avg(s.evidence_score), 2) AS evidence,
       round(100 * avg(s.combined_score), 2) AS combined
FROM predictions p
JOIN scores s USING (run_id, question_id)
GROUP BY p.run_id, looks
ORDER BY p.run_id, looks;
