// time.shift of change: the same person's pose when t1 moves by $by frames.
MATCH (m1:Moment)-[s:Shift]->(moved:Moment)
WHERE s.by = $by AND m1.pose IS NOT NULL
RETURN m1.id AS at1,
       CASE WHEN moved.absent THEN 'empty'
            WHEN moved.pose IS NULL THEN 'unknown'
            WHEN moved.pose = m1.pose THEN 'same'
            ELSE 'different' END AS outcome,
       moved.pose AS answer
ORDER BY at1
