// Mark one of the sightings as replaced by a later write.
MATCH (n:Entity {id: $source})-[r:Sighted]->(:Observation)
WHERE r.write = $write
SET r.current = false, r.until = $until
