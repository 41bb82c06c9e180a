-- How often each text is the true choice of a template. A guesser that always gives this text reaches this score.
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
