// Groups forming and dissolving: who joins and who leaves which group, in order of time.
// param sequence: text
MATCH (p:Person)-[m:MemberOf]->(g:SocialGroup)
WHERE m.sequence = $sequence AND m.certain
RETURN m.first AS frame, 'joins' AS change, g.cluster AS cluster, p.track AS track
UNION ALL
MATCH (p:Person)-[m:MemberOf]->(g:SocialGroup)
WHERE m.sequence = $sequence AND m.certain
RETURN m.last AS frame, 'leaves' AS change, g.cluster AS cluster, p.track AS track;
