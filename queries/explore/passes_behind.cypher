// Who passes behind the robot: people seen in its back sector, and while doing what.
// param sequence = "gates-ai-lab-2019-02-08_0"
MATCH (p:Person)-[seen:SeenIn]->(:Frame)
WHERE seen.sequence = $sequence AND seen.sector = 'behind' AND seen.sector_other IS NULL
RETURN p.track AS track, seen.pose AS pose, min(seen.frame) AS first, max(seen.frame) AS last, count(*) AS frames,
       min(seen.distance) AS nearest_m
ORDER BY first, track, pose;
