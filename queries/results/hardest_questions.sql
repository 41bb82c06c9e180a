-- Questions by the number of runs that give both the right answer and the right box, fewest runs first.
-- param count: integer = 20
SELECT q.question_id, q.template, q.sequence, count(*) AS runs,
       sum(s.answer_score)::INT AS answered, sum(s.evidence_score)::INT AS boxed, sum(s.combined_score)::INT AS combined,
       q.question
FROM scores s
JOIN questions q USING (question_id)
GROUP BY ALL
ORDER BY combined / runs, answered / runs, boxed / runs, q.question_id
LIMIT $count;
