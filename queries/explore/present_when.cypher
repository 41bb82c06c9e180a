// Intervals with and without a box of one person. Present is certain in clear view, absent without a box for a second.
// param sequence: text
// param track: integer
MATCH (p:Person)-[r:Present|:Absent]->(:Sequence)
WHERE r.sequence = $sequence AND p.track = $track
RETURN r.first AS first, r.last AS last, round(r.last_s - r.first_s, 1) AS seconds,
       CASE label(r) WHEN 'Present' THEN 'present' ELSE 'absent' END AS what, r.certain AS certain
ORDER BY first;
