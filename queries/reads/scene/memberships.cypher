// For the events joins_group and leaves_group: who belongs, or may belong, to which group of a sequence. `certain` is false
// for hard labels and closed gaps.
MATCH (p:Person)-[r:MemberOf|MayBelong]->(g:SocialGroup)
WHERE r.sequence IN $scopes
RETURN p.track AS who, g.cluster AS cluster, r.first AS first, r.last AS last, coalesce(r.certain, false) AS certain
ORDER BY who, cluster, first, last, certain
