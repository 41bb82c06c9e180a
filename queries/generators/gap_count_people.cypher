// Whom the companies of gap_count meet: from which keyframe on, and from which both are in clear view as well.
MATCH (c:Company)-[w:Meets]->(p:Person)
WHERE w.met IS NOT NULL
RETURN c.id AS company, p.id AS person, w.met AS met, w.seen AS seen
ORDER BY company, person
