// Return the people in a frame who may do an action by a label (an unsteady one also a second away) or without a list.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND NOT s.covered
OPTIONAL MATCH (n)-[r:Performs|MayPerform]->(x:Action)
WHERE x.name = v AND (r.first <= t AND r.last >= t OR label(r) = 'Performs' AND list_contains($flickering, v)
  AND (r.first <= t - 15 AND r.last >= t - 15 OR r.first <= t + 15 AND r.last >= t + 15))
WITH id, n, s, count(r) AS labels, coalesce(max(r.certain AND r.first <= t AND r.last >= t), false) AS certain
WHERE labels > 0 OR NOT s.listed RETURN id, n.track AS who, certain ORDER BY id, who
