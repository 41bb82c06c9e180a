// Delete the observations of a run's episodes, with the edges that end there.
MATCH (e:Episode)-[:Made]->(o:Observation)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE o
