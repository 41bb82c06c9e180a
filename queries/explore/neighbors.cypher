// People near one person at a frame: their place as seen from that person, or first to a side in the robot's view.
// param track: integer
// param frame: integer
MATCH (a:Person)-[r:Beside]->(b:Person)
WHERE r.sequence = $sequence AND a.track = $track AND r.first <= $frame AND r.last >= $frame
RETURN r.label AS place, b.track AS track, r.first AS first, r.last AS last, r.certain AS certain
ORDER BY track, first, last, certain, place;
