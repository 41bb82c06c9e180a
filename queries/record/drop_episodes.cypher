// Takes a run's episodes away, once what they hold has gone.
MATCH (e:Episode)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE e
