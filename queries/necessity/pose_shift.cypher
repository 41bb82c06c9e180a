// time.shift of change and later_pose: the same person's pose when t1 moves by $by frames.
// A person who is absent then has none.
// param sequence: text
// $by: plus or minus 15 times the rule shift_s, plus where it is not passed. Any other number finds no rows.
// param by: integer = 45
MATCH (m1:Moment)-[s:Shift]->(moved:Moment)
WHERE m1.id >= $low AND m1.id < $high
  AND moved.id >= $low AND moved.id < $high
  AND s.by = $by AND m1.pose IS NOT NULL AND (moved.pose IS NOT NULL OR moved.seen = 0)
RETURN m1.track AS a, m1.frame AS t1, moved.pose AS answer
ORDER BY a, t1
