// Return the people who may be in a person's group. A person without a certain membership may be in any group.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.person AS person
MATCH (n:Person)-[:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND n.id = person WITH id, t, n, f
OPTIONAL MATCH (n)-[r:MemberOf|MayBelong]->(g:SocialGroup) WHERE r.first <= t AND r.last >= t
WITH id, t, n, f, g.id AS own, coalesce(r.certain, false) AS sure MATCH (m:Person)-[z:SeenIn]->(f)
WHERE m.sequence IN $scopes AND m.id <> n.id AND NOT z.covered
OPTIONAL MATCH (m)-[o:MemberOf|MayBelong]->(h:SocialGroup) WHERE o.first <= t AND o.last >= t
WITH id, m.track AS who, coalesce(own = h.id, false) AS shared, sure AND coalesce(o.certain, false) AS easy
WITH id, who, max(shared) AS near, max(easy) AS easy, max(shared AND easy) AS certain
WHERE near OR NOT easy RETURN id, who, certain ORDER BY id, who
