-- What each run spent per question: observations, model calls, tokens, seconds.
SELECT run_id, count(*) AS predictions,
       round(avg(n_observations), 2) AS observations,
       round(avg(n_model_calls), 2) AS model_calls,
       round(avg(prompt_tokens), 0) AS prompt_tokens,
       round(avg(completion_tokens), 0) AS completion_tokens,
       round(avg(seconds), 3) AS seconds,
       count(*) FILTER (WHERE status = 'invalid') AS invalid,
       count(*) FILTER (WHERE status = 'error') AS errors
FROM predictions
GROUP BY run_id
ORDER BY run_id;
