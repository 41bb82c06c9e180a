// Delete the slots of a run's episodes, together with their edges.
MATCH (e:Episode)-[:Asks]->(s:Slot)
WHERE e.run = $run
DETACH DELETE s
