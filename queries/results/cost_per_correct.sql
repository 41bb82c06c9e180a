-- Cost of a run divided by the number of questions with right answer and box: looks, model calls, tokens and seconds.
SELECT p.run_id, sum(s.combined_score)::INT AS correct,
       round(sum(p.n_observations) / nullif(sum(s.combined_score), 0), 2) AS looks,
       round(sum(p.n_model_calls) / nullif(sum(s.combined_score), 0), 2) AS calls,
       round(sum(p.prompt_tokens + p.completion_tokens) / nullif(sum(s.combined_score), 0), 0) AS tokens,
       round(sum(p.seconds) / nullif(sum(s.combined_score), 0), 3) AS seconds
FROM predictions p
JOIN scores s USING (run_id, question_id)
GROUP BY p.run_id
ORDER BY p.run_id;
