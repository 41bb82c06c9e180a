// Takes away what a run's episodes hold in Observation, with the edges that end there.
MATCH (e:Episode)-[:Made]->(o:Observation)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE o
