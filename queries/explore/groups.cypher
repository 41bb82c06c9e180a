// The groups at one frame, each with its certain members.
// param frame: integer
MATCH (p:Person)-[m:MemberOf]->(g:SocialGroup)
WHERE m.sequence = $sequence AND m.first <= $frame AND m.last >= $frame AND m.certain
RETURN g.cluster AS cluster, count(*) AS size, list_sort(collect(p.track)) AS members
ORDER BY size DESC, cluster;
