// Return who performs, or may perform, which action at each keyframe of a sequence. `now` is false of labels that are
// written one second earlier or later.
MATCH (f:Frame), (p:Person)-[r:Performs|MayPerform]->(x:Action)
WHERE f.sequence = $sequence AND f.keyframe AND r.sequence = $sequence AND (r.first <= f.frame AND r.last >= f.frame
  OR label(r) = 'Performs' AND (r.first <= f.frame - 15 AND r.last >= f.frame - 15
  OR r.first <= f.frame + 15 AND r.last >= f.frame + 15))
WITH f, p, x, r, r.first <= f.frame AND r.last >= f.frame AS now
RETURN f.frame AS frame, p.track AS who, coalesce(r.certain AND now, false) AS certain, x.name AS value, now
ORDER BY frame, who
