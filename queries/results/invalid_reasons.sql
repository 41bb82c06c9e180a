-- Reasons of invalid and failed answers in each run, most frequent first. # replaces the numbers in a reason.
SELECT run_id, status, regexp_replace(reason, '[0-9]+', '#', 'g') AS reason, count(*) AS times
FROM predictions
WHERE status <> 'answered'
GROUP BY ALL
ORDER BY run_id, times DESC, status, reason;
