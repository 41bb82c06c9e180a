// People who look at the robot, with the total time, longest first. Labels marked as hard do not count.
MATCH (p:Person)-[r:Performs]->(a:Action)
WHERE r.sequence = $sequence AND a.name = 'looking at robot' AND r.certain
RETURN p.track AS track, count(*) AS times, min(r.first) AS first, max(r.last) AS last,
       round(sum(r.last_s - r.first_s), 1) AS seconds
ORDER BY seconds DESC, track;
