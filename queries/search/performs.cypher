// Return which person performs, or may perform, which action at each keyframe of a sequence.
MATCH (f:Frame), (p:Person)-[r:Performs|MayPerform]->(x:Action)
WHERE f.sequence = $sequence AND f.keyframe AND r.sequence = $sequence AND r.first <= f.frame AND r.last >= f.frame
RETURN f.frame AS frame, p.track AS who, coalesce(r.certain, false) AS certain, x.name AS value ORDER BY frame, who
