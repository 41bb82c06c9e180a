// Return the people in a frame who may interact with somebody in it. It is certain only of somebody in clear view.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v
MATCH (:Person)-[z:SeenIn]->(f:Frame) WHERE f.id = at
WITH id, at, t, v, count(*) AS people, min(z.interactions_listed) AS listed
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE f.id = at AND NOT s.covered
OPTIONAL MATCH (n)-[r:Interacts|MayInteract]->(:Person)-[y:SeenIn]->(g:Frame)
WHERE g.id = at AND r.label = v AND r.first <= t AND r.last >= t
WITH id, n, people, listed, count(r) AS labels, coalesce(max(r.certain AND (y.clear OR NOT $in_view)), false) AS certain
WHERE labels > 0 OR people > 1 AND NOT listed
RETURN id, n.track AS who, certain ORDER BY id, who
