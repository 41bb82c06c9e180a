// Changes of groups in order of time: people who join or leave, also because they come into view or leave it.
// A closed gap between two labels of one group is no change.
// param sequence: text
MATCH (s:Sequence)
WHERE s.sequence = $sequence
WITH coalesce(s.action_step, 1) AS step
MATCH (p:Person)-[m:MemberOf]->(g:SocialGroup)
WHERE m.sequence = $sequence
UNWIND ['joins', 'leaves'] AS change
WITH p, m, g, change, step
WHERE NOT EXISTS { MATCH (p)-[n:MemberOf|MayBelong]->(g)
                   WHERE n.sequence = $sequence
                         AND (change = 'joins' AND n.last < m.first AND n.last >= m.first - step
                              OR change = 'leaves' AND n.first > m.last AND n.first <= m.last + step) }
RETURN CASE change WHEN 'joins' THEN m.first ELSE m.last END AS frame, change, g.cluster AS cluster,
       p.track AS track, m.certain AS certain
ORDER BY frame, cluster, track, change;
