// People who pass behind the robot, with the first and last frame there and the smallest distance.
MATCH (p:Person)-[seen:SeenIn]->(:Frame)
WHERE seen.sequence = $sequence AND seen.sector = 'behind'
RETURN p.track AS track, min(seen.frame) AS first, max(seen.frame) AS last, count(*) AS frames,
       round(min(seen.distance), 1) AS nearest_m
ORDER BY first, track;
