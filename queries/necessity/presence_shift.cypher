// time.shift of presence: whether everybody is present (1) or absent (0) $by frames later, where it is known.
// Both times of a question move.
// param sequence: text
// $by: plus or minus 15 times the rule shift_s, plus where it is not passed. Any other number finds no rows.
// param by: integer = 45
MATCH (m:Moment)-[s:Shift]->(moved:Moment)
WHERE m.id >= $low AND m.id < $high
  AND moved.id >= $low AND moved.id < $high
  AND s.by = $by AND moved.seen IS NOT NULL
RETURN m.track AS a, m.frame AS frame, moved.seen AS seen
ORDER BY a, frame
