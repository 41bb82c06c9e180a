// Delete the episodes of a run. Their entities and other nodes must be deleted first.
MATCH (e:Episode)
WHERE e.run = $run
DETACH DELETE e
