// Mark an edge that a later write replaces.
MATCH (n:Entity {id: $source})-[r:Sighted]->(:Observation)
WHERE r.write = $write
SET r.current = false, r.until = $until
