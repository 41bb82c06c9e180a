// Return the boxes of a person around frame `t`, the possible start of an action, and whether the action holds in each.
UNWIND $asked AS q WITH q.id AS id, q.scope AS scope, q.t AS t, q.v AS v, q.posture AS posture, q.person AS person
MATCH (z:Sequence), (n:Person)-[s:SeenIn]->(:Frame) WHERE n.sequence IN $scopes AND z.sequence = scope
  AND n.id = person AND s.frame >= t - 30 AND s.frame <= t + 15 + CASE z.action_step WHEN 1 THEN 0 ELSE 7 END
OPTIONAL MATCH (n)-[r:Performs|MayPerform]->(x:Action) WHERE x.name = v AND r.first <= s.frame AND r.last >= s.frame
WITH id, v, posture, s, count(r) AS labels, coalesce(max(r.certain), false) AS certain
RETURN id, s.frame AS frame, s.angle AS angle,
       CASE WHEN posture = true THEN coalesce(s.pose = v, false) ELSE certain END AS certain,
       labels > 0 OR CASE WHEN posture = true THEN NOT s.posed ELSE NOT s.listed END AS could ORDER BY id, frame
