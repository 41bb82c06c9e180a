// Delete the entities of a run's episodes, together with their edges.
MATCH (e:Episode)-[:Holds]->(n:Entity)
WHERE e.run = $run
DETACH DELETE n
