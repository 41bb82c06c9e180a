-- Why replies were no valid answers, the commonest reason of each run first; numbers in it are written as #.
SELECT run_id, status, regexp_replace(reason, '[0-9]+', '#', 'g') AS reason, count(*) AS times
FROM predictions
WHERE status <> 'answered'
GROUP BY ALL
ORDER BY run_id, times DESC, status, reason;
