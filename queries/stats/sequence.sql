-- Questions of each loaded sequence, and the number of their target people.
SELECT sequence, count(question_id) AS n, n / greatest(sum(count(question_id)) OVER (), 1) AS share,
       count(DISTINCT target_track) AS people, occlusion
FROM loaded
LEFT JOIN measured USING (sequence)
GROUP BY sequence, occlusion
ORDER BY sequence;
