// Delete the observations of a run's episodes, together with their edges.
MATCH (e:Episode)-[:Made]->(o:Observation)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE o
