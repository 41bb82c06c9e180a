// Return the people who may be in a person's group. A person without a certain membership may be in any group.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.person AS person
MATCH (n:Person)-[:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND n.id = person WITH id, t, n, f
OPTIONAL MATCH (n)-[r:MemberOf]->(g:SocialGroup) WHERE r.first <= t AND r.last >= t AND r.certain
WITH id, t, n, f, g.id AS own
MATCH (m:Person)-[z:SeenIn]->(f) WHERE m.sequence IN $scopes AND m.id <> n.id AND NOT z.covered
OPTIONAL MATCH (m)-[o:MemberOf]->(h:SocialGroup) WHERE o.first <= t AND o.last >= t AND o.certain
WITH id, m.track AS who, own = h.id AS shared WHERE shared IS NULL OR shared
RETURN id, who, coalesce(max(shared), false) AS certain ORDER BY id, who
