// The groups at one frame with their members (those whose membership is not certain are left out).
// param sequence = "gates-ai-lab-2019-02-08_0"
// param frame = 15
MATCH (p:Person)-[m:MemberOf]->(g:SocialGroup)
WHERE m.sequence = $sequence AND m.first <= $frame AND m.last >= $frame AND m.certain
RETURN g.cluster AS cluster, count(*) AS size, list_sort(collect(p.track)) AS members
ORDER BY size DESC, cluster;
