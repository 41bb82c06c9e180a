// For each person at a keyframe: the first to the right in the robot's view, and the first to the right of that person.
// param frame: integer
MATCH (a:Person)-[r:Beside]->(b:Person)
WHERE r.sequence = $sequence AND r.label = 'first to the right of (robot view)' AND r.first <= $frame
      AND r.last >= $frame AND r.certain
WITH a, b
OPTIONAL MATCH (b)-[next:Beside]->(c:Person)
WHERE next.sequence = $sequence AND next.label = 'first to the right of (robot view)' AND next.first <= $frame
      AND next.last >= $frame AND next.certain
RETURN a.track AS track, b.track AS first_right, c.track AS then_right
ORDER BY track, first_right, then_right;
