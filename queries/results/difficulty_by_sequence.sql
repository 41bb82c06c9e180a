-- Difficulty of each sequence: people per frame, share of clear views, and scores over all runs, in percent.
WITH crowd AS (
    SELECT sequence, round(count(*) / count(DISTINCT frame), 1) AS people_per_frame,
           round(100 * avg(clear::INT), 1) AS clear_views
    FROM intervals_sightings
    GROUP BY sequence
)
SELECT q.sequence, any_value(c.people_per_frame) AS people_per_frame, any_value(c.clear_views) AS clear_views,
       count(DISTINCT q.question_id) AS questions, count(DISTINCT s.run_id) AS runs,
       round(100 * avg(s.answer_score), 2) AS answer, round(100 * avg(s.evidence_score), 2) AS evidence,
       round(100 * avg(s.combined_score), 2) AS combined
FROM scores s
JOIN questions q USING (question_id)
LEFT JOIN crowd c USING (sequence)
GROUP BY q.sequence
ORDER BY combined, q.sequence;
