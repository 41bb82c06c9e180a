// Delete the episodes of a run. Their entities and other nodes must be deleted first.
MATCH (e:Episode)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE e
