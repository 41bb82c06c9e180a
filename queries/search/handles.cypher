// Return which person handles, or may handle, a thing of which category at each keyframe of a sequence, and how.
MATCH (f:Frame), (p:Person)-[r:Handles|MayHandle]->(x:Object)
WHERE f.sequence = $sequence AND f.keyframe AND r.sequence = $sequence AND r.first <= f.frame AND r.last >= f.frame
RETURN f.frame AS frame, p.track AS who, coalesce(r.certain, false) AS certain, r.verb AS verb, x.category AS value
ORDER BY frame, who
