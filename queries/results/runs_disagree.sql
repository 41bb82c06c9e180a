-- For each pair of runs: number and examples of questions that only the first run has fully right (answer and box).
SELECT a.run_id AS scores_it, b.run_id AS misses_it, q.template, count(*) AS questions,
       list_sort(list(q.question_id))[1:3] AS examples
FROM scores a
JOIN scores b ON a.question_id = b.question_id AND a.combined_score > b.combined_score
JOIN questions q ON q.question_id = a.question_id
GROUP BY ALL
ORDER BY scores_it, misses_it, questions DESC, q.template;
