-- Questions with a right answer but a wrong box in every run, which suggests that the answer can be guessed.
SELECT q.question_id, q.template, q.sequence, count(*) AS runs, q.question
FROM scores s
JOIN questions q USING (question_id)
GROUP BY ALL
HAVING min(s.answer_score) = 1 AND max(s.evidence_score) = 0
ORDER BY q.template, q.question_id;
