// Intervals with a box of one person (certain if in clear view), and without a box (certain if none within a second).
// param track: integer
MATCH (p:Person)-[r:Present|:Absent]->(:Sequence)
WHERE r.sequence = $sequence AND p.track = $track
RETURN r.first AS first, r.last AS last, round(r.last_s - r.first_s, 1) AS seconds,
       CASE label(r) WHEN 'Present' THEN 'present' ELSE 'absent' END AS what, r.certain AS certain
ORDER BY first;
