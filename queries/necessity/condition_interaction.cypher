// Return the people in a frame who may interact with somebody in it: by a label, or if one of both lists was not read.
// If the rules judge who is in clear view, it is certain only if the other person is in clear view.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE f.id = at AND NOT s.covered
WITH id, t, v, n, s, f
MATCH (m:Person)-[z:SeenIn]->(f) WHERE m.id <> n.id
OPTIONAL MATCH (n)-[r:Interacts|MayInteract]->(m) WHERE r.label = v AND r.first <= t AND r.last >= t
WITH id, n, s, z, count(r) AS labels,
     sum(CASE WHEN r.certain = true AND (z.clear = true OR $judged = false) THEN 1 ELSE 0 END) AS sure
WHERE labels > 0 OR NOT s.interactions_listed OR NOT z.interactions_listed
RETURN id, n.track AS who, max(sure) > 0 AS certain ORDER BY id, who
