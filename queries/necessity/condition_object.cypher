// Return the people in a frame who may handle, by the verb `w`, a thing of a category. An unknown category may be any.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.v AS v, q.w AS w
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND NOT s.covered
OPTIONAL MATCH (n)-[r:Handles|MayHandle]->(x:Object)
WHERE r.first <= t AND r.last >= t AND r.verb = w AND (x.category IS NULL OR x.category = v)
WITH id, n, s, count(r) AS labels, coalesce(max(r.certain AND x.category IS NOT NULL), false) AS certain
WHERE labels > 0 OR NOT s.handles_listed RETURN id, n.track AS who, certain ORDER BY id, who
