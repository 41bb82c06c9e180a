// Return which person performs, or may perform, which action at each keyframe (`now`), or is labelled so a second away.
MATCH (f:Frame), (p:Person)-[r:Performs|MayPerform]->(x:Action) WHERE f.sequence = $sequence AND f.keyframe
  AND r.sequence = $sequence AND (r.first <= f.frame AND r.last >= f.frame OR label(r) = 'Performs'
  AND (r.first <= f.frame - 15 AND r.last >= f.frame - 15 OR r.first <= f.frame + 15 AND r.last >= f.frame + 15))
WITH f.frame AS frame, p.track AS who, x, r, r.first <= f.frame AND r.last >= f.frame AS now
RETURN frame, who, x.name AS value, now, coalesce(r.certain AND now, false) AS certain,
       label(r) = 'Performs' AND now AS written, coalesce(r.difficulty < 3, false) AS easy ORDER BY frame, who
