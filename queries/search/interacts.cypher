// Return who interacts, or may interact, with whom at each keyframe of a sequence.
MATCH (f:Frame), (p:Person)-[r:Interacts|MayInteract]->(x:Person)
WHERE f.sequence = $sequence AND f.keyframe AND r.sequence = $sequence AND r.first <= f.frame AND r.last >= f.frame
RETURN DISTINCT f.frame AS frame, p.track AS who, coalesce(r.certain, false) AS certain, r.label AS value,
       x.track AS other ORDER BY frame, who
