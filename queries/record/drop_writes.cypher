// Delete the writes of a run's episodes, together with their edges.
MATCH (e:Episode)-[:Wrote]->(w:Write)
WHERE e.run = $run
DETACH DELETE w
