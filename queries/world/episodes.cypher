// Episodes of a run.
MATCH (e:Episode)
WHERE e.run = $run
RETURN e.id AS episode
ORDER BY episode
