// Who passes behind the robot: people seen in its back sector for certain, from when to when, and how near.
// param sequence: text
MATCH (p:Person)-[seen:SeenIn]->(:Frame)
WHERE seen.sequence = $sequence AND seen.sector = 'behind'
RETURN p.track AS track, min(seen.frame) AS first, max(seen.frame) AS last, count(*) AS frames,
       round(min(seen.distance), 1) AS nearest_m
ORDER BY first, track;
