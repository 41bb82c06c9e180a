// One person's life in order: what was done, and in which group, from when to when.
// param sequence = "gates-ai-lab-2019-02-08_0"
// param track = 1
MATCH (p:Person)-[r:Performs]->(a:Action)
WHERE r.sequence = $sequence AND p.track = $track
RETURN r.first AS first, r.last AS last, r.first_s AS first_s, r.last_s AS last_s, 'does' AS what, a.name AS name,
       r.certain AS certain
UNION
MATCH (p:Person)-[m:MemberOf]->(g:SocialGroup)
WHERE m.sequence = $sequence AND p.track = $track
RETURN m.first AS first, m.last AS last, m.first_s AS first_s, m.last_s AS last_s, 'is in group' AS what,
       CAST(g.cluster AS STRING) AS name, m.certain AS certain;
