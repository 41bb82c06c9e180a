// Return who performs, or may perform, which action at each keyframe of a sequence. An action of $flickering may
// also be performed one second before and after a written label.
MATCH (f:Frame), (p:Person)-[r:Performs|MayPerform]->(x:Action)
WHERE f.sequence = $sequence AND f.keyframe AND r.sequence = $sequence
  AND (r.first <= f.frame AND r.last >= f.frame OR label(r) = 'Performs' AND list_contains($flickering, x.name)
  AND (r.first <= f.frame - 15 AND r.last >= f.frame - 15 OR r.first <= f.frame + 15 AND r.last >= f.frame + 15))
RETURN DISTINCT f.frame AS frame, p.track AS who, x.name AS value,
       coalesce(r.certain AND r.first <= f.frame AND r.last >= f.frame, false) AS certain
ORDER BY frame, who
