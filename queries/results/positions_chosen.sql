-- How often each run selects each position in the list of choices, and how often the true choice is there.
WITH given AS (
    SELECT p.run_id, CAST(json_extract(p.answer, '$.choice') AS INT) AS place, 1 AS chosen, 0 AS right_one
    FROM predictions p
    JOIN questions q USING (question_id)
    WHERE q.answer_mode = 'multiple_choice' AND p.answer IS NOT NULL
    UNION ALL
    SELECT p.run_id, CAST(json_extract(a.answer, '$.choice') AS INT), 0, 1
    FROM predictions p
    JOIN answers a USING (question_id)
    JOIN questions q USING (question_id)
    WHERE q.answer_mode = 'multiple_choice'
)
SELECT run_id, place, sum(chosen)::INT AS chosen, sum(right_one)::INT AS true_there
FROM given
GROUP BY run_id, place
ORDER BY run_id, place;
