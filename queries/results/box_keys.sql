-- JSON keys that the models used for their boxes. The prompts ask for bbox, and the tools of the agent for box.
WITH solved AS (
    SELECT run_id, question_id,
           CASE WHEN json_valid(response) THEN json_extract_string(response, '$.box_key') END AS box_key
    FROM steps
    WHERE kind = 'solve'
)
SELECT run_id, box_key, count(*) AS times, count(DISTINCT question_id) AS questions
FROM solved
WHERE box_key IS NOT NULL
GROUP BY ALL
ORDER BY run_id, times DESC, box_key;
