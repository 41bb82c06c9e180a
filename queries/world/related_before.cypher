// Mark one of the relations as replaced by a later write.
MATCH (n:Entity {id: $source})-[r:Related]->(:Entity)
WHERE r.write = $write
SET r.current = false, r.until = $until
