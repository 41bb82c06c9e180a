// Return the people in a frame who may interact with another one. It is certain only with a person in clear view.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v
MATCH (n:Person)-[z:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at
WITH id, at, t, v, count(*) AS people, min(z.interactions_listed) AS listed
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND NOT s.covered
OPTIONAL MATCH (n)-[r:Interacts|MayInteract]->(m:Person) WHERE r.label = v AND r.first <= t AND r.last >= t
WITH id, at, people, listed, n, m, r.certain AS sure
OPTIONAL MATCH (m)-[z:SeenIn]->(f:Frame) WHERE m.sequence IN $scopes AND f.id = at
WITH id, n, people, listed, count(z) AS labels,
     coalesce(max(sure AND z.frame IS NOT NULL AND (z.clear OR NOT $in_view)), false) AS certain
WHERE labels > 0 OR people > 1 AND NOT listed RETURN id, n.track AS who, certain ORDER BY id, who
