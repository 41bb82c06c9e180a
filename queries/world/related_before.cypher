// Mark an edge that a later write replaces.
MATCH (n:Entity {id: $source})-[r:Related]->(:Entity)
WHERE r.write = $write
SET r.current = false, r.until = $until
