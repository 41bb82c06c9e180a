// Return which person belongs, or may belong, to which group at each keyframe of a sequence.
MATCH (f:Frame), (p:Person)-[r:MemberOf|MayBelong]->(x:SocialGroup)
WHERE f.sequence = $sequence AND f.keyframe AND r.sequence = $sequence AND r.first <= f.frame AND r.last >= f.frame
RETURN f.frame AS frame, p.track AS who, coalesce(r.certain, false) AS certain, x.cluster AS value ORDER BY frame, who
