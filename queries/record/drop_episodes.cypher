// Delete the episodes of a run after their contents.
MATCH (e:Episode)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE e
