-- Refused writes of agents into their world models, by tool and reason. # replaces the numbers in a reason.
SELECT run_id, tool, regexp_replace(reason, '[0-9]+', '#', 'g') AS reason, count(*) AS times,
       count(DISTINCT question_id) AS questions
FROM world
WHERE NOT accepted
GROUP BY ALL
ORDER BY run_id, times DESC, tool, reason;
