// For the reads start, span, start_view and seconds_between: the first start of an action by a person after a frame.
// The start begins a stable segment of the action, from `first` to `last`. Before it, the action is false at all frames
// since `after`. `start` and `end` are the values that a question expects. `closed` is true if the end is known.
// `angle` is the panorama angle of the person at `first`. The frames with action labels are low, low + step, ..., high.
UNWIND $plans AS q
WITH q.id AS id, q.scope AS scope, q.who AS who, q.action AS action, q.posture AS posture, q.after AS after,
     q.low AS low, q.high AS high, q.step AS step
WHERE after >= low AND (after - low) % step = 0
MATCH (p:Person)-[r:Performs|MayPerform]->(x:Action)
WHERE p.sequence IN $scopes AND p.sequence = scope AND p.track = who AND x.name = action AND r.last >= after
WITH id, action, posture, after, low, high, step, p, min(r.first) AS first
WHERE first > after
// The segment is a chain of intervals from `first` on, without gaps. It ends with the interval that has no successor.
MATCH (p)-[r:Performs|MayPerform]->(x:Action)
WHERE x.name = action AND r.first >= first
  AND NOT EXISTS { MATCH (p)-[n:Performs|MayPerform]->(y:Action) WHERE y.name = action AND n.first = r.last + step }
WITH id, action, posture, after, low, high, step, p, first, min(r.last) AS last
WHERE last - first >= $least
MATCH (p)-[r:Performs|MayPerform]->(x:Action)
WHERE x.name = action
WITH id, action, posture, after, low, high, step, p, first, last,
     max(CASE WHEN r.last < first THEN r.last END) AS before,
     min(CASE WHEN r.first > last THEN r.first END) AS next,
     sum(CASE WHEN r.first >= first AND r.last <= last AND (r.certain = false OR r.gap = false) THEN 1 ELSE 0 END) AS unsure,
     sum(CASE WHEN r.first >= first AND r.last <= last AND r.certain = true THEN (r.last - r.first) / step + 1 ELSE 0 END)
         AS named,
     $edge / step * step AS edge, $quiet / step * step AS quiet
WHERE unsure = 0 AND first - edge >= low
  AND (before IS NULL OR (before < first - edge AND before < first - quiet))
  AND (next IS NULL OR next > last + quiet)
// Require a clear view of the person at all frames of the segment.
MATCH (p)-[r:Performs]->(x:Action)
WHERE x.name = action AND r.certain AND r.first >= first AND r.last <= last
WITH id, posture, after, low, high, step, p, first, last, next, edge, quiet, named, r.first AS since, r.last AS until
MATCH (p)-[s:SeenIn]->(:Frame)
WHERE s.frame >= since AND s.frame <= until AND (s.frame - low) % step = 0 AND s.clear
WITH id, posture, after, low, high, step, p, first, last, next, edge, quiet, named, count(*) AS clear
WHERE clear = named
// Count the frames with action labels before and after the segment. At these frames, the action is false.
MATCH (p)-[s:SeenIn]->(:Frame)
WHERE (s.frame - low) % step = 0
WITH id, after, low, high, step, first, last, next, edge, quiet, s.frame AS t, s.angle AS angle, s.clear AS clear,
     CASE WHEN posture = true THEN s.posed ELSE s.listed END AS told
WITH id, after, low, high, step, first, last, next, edge, quiet,
     max(CASE WHEN t = first THEN angle END) AS angle,
     sum(CASE WHEN told = true AND t >= after AND t < first THEN 1 ELSE 0 END) AS since,
     sum(CASE WHEN told = true AND clear = true AND t >= first - edge AND t < first THEN 1 ELSE 0 END) AS edge_before,
     sum(CASE WHEN told = true AND t >= first - quiet AND t < first THEN 1 ELSE 0 END) AS quiet_before,
     sum(CASE WHEN told = true AND t > last AND t <= last + quiet AND t <= high THEN 1 ELSE 0 END) AS quiet_after,
     sum(CASE WHEN told = true AND clear = true AND t > last AND t <= last + edge THEN 1 ELSE 0 END) AS edge_after
WHERE since = (first - after) / step AND edge_before = edge / step
  AND quiet_before = CASE WHEN first - quiet < low THEN (first - low) / step ELSE quiet / step END
  AND quiet_after = CASE WHEN last + quiet > high THEN (high - last) / step ELSE quiet / step END
RETURN id, first, last, first - CASE WHEN step = 1 THEN 0 ELSE step / 2 END AS start,
       last + CASE WHEN step = 1 THEN 0 ELSE step / 2 END AS `end`,
       edge_after = edge / step AND last + edge <= high AND (next IS NULL OR next > last + edge) AS closed, angle
ORDER BY id
