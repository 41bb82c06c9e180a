// The keyframes with the most people in view, over all sequences, and how many of the people are in clear view.
// param count: integer = 20
MATCH (:Person)-[seen:SeenIn]->(f:Frame)
WHERE f.keyframe
RETURN f.sequence AS sequence, f.frame AS frame, round(f.seconds, 2) AS seconds, count(*) AS people,
       CAST(sum(CASE WHEN seen.clear = true THEN 1 ELSE 0 END) AS INT64) AS clearly_seen
ORDER BY people DESC, frame, sequence
LIMIT $count;
