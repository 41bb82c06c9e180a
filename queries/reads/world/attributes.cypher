// Attributes that a model read in an episode, in the order of the writes.
// Without the hint, the engine begins at the looks of all episodes.
MATCH (n:Entity {episode_hash: UUID($hash)})-[r:Has]->(o:Look)
WHERE r.origin = 'model' AND r.step <= $step AND ($everyone OR list_contains($people, n.name))
HINT (n JOIN r) JOIN o
RETURN n.name AS entity, o.number AS look, r.name AS name, r.value AS value, r.log_odds AS log_odds, r.write AS written
ORDER BY look, written, entity, name, value
