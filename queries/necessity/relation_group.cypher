// Return the people who may be in a person's group. A person without a group label may be in any group.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.t AS t, q.person AS person
MATCH (n:Person)-[:SeenIn]->(f:Frame) WHERE f.id = at AND n.id = person WITH id, t, n, f
OPTIONAL MATCH (n)-[r:MemberOf|MayBelong]->(g:SocialGroup) WHERE r.first <= t AND r.last >= t
WITH id, t, n, f, g.id AS own, r.certain AS sure
MATCH (m:Person)-[z:SeenIn]->(f) WHERE m.id <> n.id AND NOT z.covered
OPTIONAL MATCH (m)-[o:MemberOf|MayBelong]->(h:SocialGroup) WHERE o.first <= t AND o.last >= t
WITH id, m.track AS who, own, h.id AS theirs, sure, o.certain AS also
WHERE own IS NULL OR theirs IS NULL OR own = theirs
RETURN id, who, coalesce(max(own = theirs AND sure AND also), false) AS certain ORDER BY id, who
