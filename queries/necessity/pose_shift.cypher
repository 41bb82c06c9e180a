// time.shift of change and later_pose: the same person's pose when t1 moves by $by frames; an absent person has none.
MATCH (m1:Moment)-[s:Shift]->(moved:Moment)
WHERE s.by = $by AND m1.pose IS NOT NULL AND (moved.pose IS NOT NULL OR moved.seen = 0)
RETURN m1.id AS at1, moved.pose AS answer
ORDER BY at1
