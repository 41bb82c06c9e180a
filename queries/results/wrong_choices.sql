-- How a run fails at multiple choice: the perturbation behind each wrong choice, where one is recorded.
WITH chosen AS (
    SELECT run_id, question_id, CAST(json_extract(answer, '$.choice') AS INT) AS choice
    FROM predictions
    WHERE answer IS NOT NULL AND json_extract(answer, '$.choice') IS NOT NULL
)
SELECT chosen.run_id, q.family, q.template,
       coalesce(
           regexp_replace(json_extract_string(a.distractors, '$[' || (choice - 1) || ']'), ' without .*', ''),
           'none recorded'
       ) AS perturbation,
       count(*) AS times
FROM chosen
JOIN questions q USING (question_id)
JOIN answers a USING (question_id)
WHERE choice <> CAST(json_extract(a.answer, '$.choice') AS INT)
GROUP BY ALL
ORDER BY ALL;
