// Mark one of the attributes as replaced by a later write.
MATCH (n:Entity {id: $source})-[r:Has]->(:Observation)
WHERE r.write = $write
SET r.current = false, r.until = $until
