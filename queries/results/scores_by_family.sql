-- Answer, evidence and combined score of every run, per family, in percent of the questions asked.
SELECT run_id, family, count(*) AS n,
       round(100 * avg(answer_score), 2) AS answer,
       round(100 * avg(evidence_score), 2) AS evidence,
       round(100 * avg(combined_score), 2) AS combined,
       round(100 * avg(invalid::INT), 2) AS invalid
FROM scores
JOIN questions USING (question_id)
GROUP BY run_id, family
ORDER BY run_id, family;
