// next_action: the posture after the one held at a frame, and the keyframe `until` at which it is first seen.
// The first posture is seen at every keyframe until then. (Without IS NOT NULL the engine loses rows of OPTIONAL MATCH.)
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
