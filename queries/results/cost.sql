-- Mean cost of a question in each run: looks, model calls, tokens, seconds, and tokens per combined score of 1.
SELECT run_id, method, model, if(synthetic, 'synthetic', '') AS label, count(*) AS n,
       round_even(coalesce(sum(n_observations), 0) / n, 3) AS observations,
       round_even(coalesce(sum(n_model_calls), 0) / n, 3) AS model_calls,
       round_even(coalesce(sum(prompt_tokens), 0) / n, 3) AS prompt_tokens,
       round_even(coalesce(sum(completion_tokens), 0) / n, 3) AS completion_tokens,
       round_even(coalesce(sum(seconds), 0) / n, 3) AS seconds,
       round_even(sum(p.prompt_tokens + p.completion_tokens) / nullif(sum(combined_score), 0), 0)::BIGINT
           AS tokens_per_combined
FROM scores
JOIN runs USING (run_id)
LEFT JOIN predictions p USING (run_id, question_id)
GROUP BY ALL
ORDER BY run_id;
