// Sightings of an episode, in the order of the writes.
MATCH (n:Entity {episode_hash: UUID($hash)})-[r:Sighted]->(o:Look)
WHERE r.step <= $step AND ($everyone OR list_contains($people, n.name))
RETURN n.name AS entity, r.number AS number, o.number AS look, r.frame AS frame, r.box AS box, r.whole AS whole,
       r.metres AS metres, r.write AS written
ORDER BY written, number
