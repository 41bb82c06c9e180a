// Pairs of people, with the number of keyframes that show both in clear view, largest number first.
// param count: integer = 20
MATCH (f:Frame)<-[one:SeenIn]-(a:Person)
WHERE f.sequence = $sequence AND f.keyframe AND one.sequence = $sequence AND one.clear
WITH f, a
MATCH (f)<-[two:SeenIn]-(b:Person)
WHERE two.sequence = $sequence AND two.clear AND a.track < b.track
RETURN a.track AS track, b.track AS other, count(*) AS keyframes, min(f.frame) AS first, max(f.frame) AS last
ORDER BY keyframes DESC, track, other
LIMIT $count;
