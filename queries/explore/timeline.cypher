// All labels of one person in order of time: actions, groups, partners of interactions, and handled things.
// param track: integer
MATCH (p:Person)-[r:Performs|:MemberOf|:Interacts|:Handles]->(o:Action:SocialGroup:Person:Object)
WHERE r.sequence = $sequence AND p.track = $track
RETURN r.first AS first, r.last AS last,
       CASE label(r) WHEN 'Performs' THEN 'does' WHEN 'MemberOf' THEN 'is in' WHEN 'Interacts' THEN 'with'
                     ELSE 'handles' END AS what,
       coalesce(o.name, r.label, r.verb, 'group') AS name,
       CASE label(o) WHEN 'Action' THEN '' WHEN 'SocialGroup' THEN CAST(o.cluster AS STRING)
                     WHEN 'Person' THEN CAST(o.track AS STRING)
                     ELSE concat(coalesce(o.category, '?'), ' ', CAST(o.track AS STRING)) END AS of,
       r.certain AS certain
ORDER BY first, last, certain, what, name, of;
