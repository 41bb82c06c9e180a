-- Frequency of each true choice in a multiple-choice template, which is the score of a guess that is always this text.
WITH truth AS (
    SELECT q.template, list_extract(q.choices, CAST(json_extract(a.answer, '$.choice') AS INT)) AS says
    FROM answers a
    JOIN questions q USING (question_id)
    WHERE q.answer_mode = 'multiple_choice'
)
SELECT template, says, count(*) AS times,
       round(100 * count(*) / sum(count(*)) OVER (PARTITION BY template), 2) AS percent
FROM truth
GROUP BY template, says
ORDER BY template, times DESC, says;
