-- Answer, evidence and combined score of every run, per template, in percent of the questions asked.
SELECT s.run_id, q.template, count(*) AS n,
       round(100 * avg(s.answer_score), 2) AS answer,
       round(100 * avg(s.evidence_score), 2) AS evidence,
       round(100 * avg(s.combined_score), 2) AS combined,
       round(100 * avg(s.invalid::INT), 2) AS invalid
FROM scores s
JOIN questions q USING (question_id)
GROUP BY s.run_id, q.template
ORDER BY s.run_id, q.template;
