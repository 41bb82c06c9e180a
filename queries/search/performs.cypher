// Return who performs, or may perform, which action once per second in a sequence, and whether a label of it is written.
// $phase: number of any keyframe of the sequence modulo 15.
// param phase: integer = 0
MATCH (f:Frame), (p:Person)-[r:Performs|MayPerform]->(x:Action)
WHERE f.sequence = $sequence AND f.frame % 15 = $phase AND r.sequence = $sequence AND r.first <= f.frame
  AND r.last >= f.frame
RETURN DISTINCT f.frame AS frame, p.track AS who, coalesce(r.certain, false) AS certain, x.name AS value,
       label(r) = 'Performs' AS written, coalesce(r.difficulty < 3, false) AS easy ORDER BY frame, who
