-- Number of questions about each loaded sequence, and number of different people among their targets.
SELECT sequence, count(question_id) AS n, n / greatest(sum(count(question_id)) OVER (), 1) AS share,
       count(DISTINCT target_track) AS people, occlusion
FROM loaded
LEFT JOIN measured USING (sequence)
GROUP BY sequence, occlusion
ORDER BY sequence;
