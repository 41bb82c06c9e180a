// Delete the looks of a run's episodes, together with their edges.
MATCH (e:Episode)-[:Made]->(o:Look)
WHERE e.run = $run
DETACH DELETE o
