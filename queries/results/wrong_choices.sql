-- Wrong choices of each run, by the change of the plan that gives the chosen answer, in percent of all wrong choices.
WITH chosen AS (
    SELECT run_id, question_id, TRY_CAST(TRY_CAST(answer AS JSON) ->> 'choice' AS INT) AS choice
    FROM predictions
    WHERE status <> 'error'
)
SELECT run_id,
       coalesce(
           regexp_replace(json_extract_string(distractors, '$[' || (choice - 1) || ']'), ' without .*', ''),
           'none recorded'
       ) AS perturbation,
       sum(count(*)) OVER (PARTITION BY run_id)::BIGINT AS wrong_choices, count(*) AS times,
       round_even(100 * times / wrong_choices, 2) AS percent
FROM chosen
JOIN questions USING (question_id)
JOIN answers a USING (question_id)
WHERE answer_mode = 'multiple_choice' AND choice <> (a.answer ->> 'choice')::INT
GROUP BY run_id, perturbation
ORDER BY run_id, times DESC, perturbation;
