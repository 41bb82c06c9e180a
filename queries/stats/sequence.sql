-- Number of questions about each loaded sequence, number of different people among their targets, evidence for clear views.
SELECT sequence, count(question_id) AS n, n / greatest(sum(count(question_id)) OVER (), 1) AS share,
       count(DISTINCT target_track) AS people, visibility
FROM loaded
LEFT JOIN measured USING (sequence)
GROUP BY sequence, visibility
ORDER BY sequence;
