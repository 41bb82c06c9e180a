// Return which people interact, may interact, or are beside each other, at each keyframe of a sequence.
MATCH (f:Frame), (p:Person)-[r:Beside|Interacts|MayInteract]->(x:Person)
WHERE f.sequence = $sequence AND f.keyframe AND p.sequence = $sequence AND r.first <= f.frame AND r.last >= f.frame
RETURN f.frame AS frame, p.track AS who, coalesce(r.certain, false) AS certain, r.label AS value,
       collect(x.track) AS others ORDER BY frame, who
