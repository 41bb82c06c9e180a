-- Questions that every run answered right and no run with the right box, which suggests that they can be guessed.
SELECT q.question_id, q.template, q.sequence, count(*) AS runs, q.question
FROM scores s
JOIN questions q USING (question_id)
GROUP BY ALL
HAVING min(s.answer_score) = 1 AND max(s.evidence_score) = 0
ORDER BY q.template, q.question_id;
