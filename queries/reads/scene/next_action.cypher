// For the read next_action: the pose that follows the pose of a person at a frame. `until` is the first keyframe with
// the next pose. The person has the first pose at every keyframe before `until`.
// The condition IS NOT NULL is needed, because without it the engine loses rows of OPTIONAL MATCH.
UNWIND $plans AS q
WITH q.id AS id, q.scope AS scope, q.who AS who, q.after AS after
MATCH (p:Person)-[s:SeenIn]->(:Frame)
WHERE s.sequence = scope AND s.frame = after AND p.track = who AND s.pose IS NOT NULL
WITH id, scope, after, p, s.pose AS held
MATCH (f:Frame)
WHERE f.sequence = scope AND f.keyframe AND f.frame > after
WITH id, scope, after, p, held, f
OPTIONAL MATCH (p)-[s:SeenIn]->(f)
WHERE s.pose IS NOT NULL AND s.pose = held
WITH id, scope, after, p, f.frame AS k, count(s) AS holds
WITH id, scope, after, p, min(CASE WHEN holds = 0 THEN k END) AS until
MATCH (f:Frame)
WHERE f.sequence = scope AND f.keyframe AND f.frame > after AND f.frame <= until
WITH id, after, p, until, count(*) AS keyframes
WHERE keyframes = (until - after) / 15
MATCH (p)-[s:SeenIn]->(:Frame)
WHERE s.frame = until
RETURN id, s.pose AS pose, until
ORDER BY id
