// Whom the encounters of gap_count meet: from which keyframe on, and from which both are in clear view as well.
// param sequence: text
MATCH (e:Encounter)-[w:Meets]->(p:Person)
WHERE e.id >= $low AND e.id < $high
  AND w.met IS NOT NULL
RETURN e.id - $low AS encounter, p.track AS person, w.met AS met, w.clear_from AS clear_from
ORDER BY encounter, person
