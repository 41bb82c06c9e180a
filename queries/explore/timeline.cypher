// One person's life in order: actions, groups, partners and things handled, from which frame to which.
// param sequence: text
// param track: integer
MATCH (p:Person)-[r:Performs]->(a:Action)
WHERE r.sequence = $sequence AND p.track = $track
RETURN r.first AS first, r.last AS last, 'does' AS what, a.name AS name, '' AS of, r.certain AS certain
UNION ALL
MATCH (p:Person)-[r:MemberOf]->(g:SocialGroup)
WHERE r.sequence = $sequence AND p.track = $track
RETURN r.first AS first, r.last AS last, 'is in' AS what, 'group' AS name, CAST(g.cluster AS STRING) AS of,
       r.certain AS certain
UNION ALL
MATCH (p:Person)-[r:Interacts]->(o:Person)
WHERE r.sequence = $sequence AND p.track = $track
RETURN r.first AS first, r.last AS last, 'with' AS what, r.label AS name, CAST(o.track AS STRING) AS of,
       r.certain AS certain
UNION ALL
MATCH (p:Person)-[r:Handles]->(o:Object)
WHERE r.sequence = $sequence AND p.track = $track
RETURN r.first AS first, r.last AS last, 'handles' AS what, r.verb AS name,
       concat(coalesce(o.category, '?'), ' ', CAST(o.track AS STRING)) AS of, r.certain AS certain;
