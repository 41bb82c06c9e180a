// People who join or leave a group, in order of time.
// Coming into view counts as joining, and going out of view counts as leaving.
// A short gap between two labels of the same group does not count as a change.
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
