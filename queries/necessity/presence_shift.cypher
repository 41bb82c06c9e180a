// time.shift of presence: whether everybody is present (1) or absent (0) $by frames later, where it is known.
// What is asked at two times moves with both.
MATCH (m:Moment)-[s:Shift]->(moved:Moment)
WHERE s.by = $by AND moved.seen IS NOT NULL
RETURN m.id AS at, moved.seen AS seen
ORDER BY at
