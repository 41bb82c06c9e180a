// Delete the slots of a run's episodes, together with their edges.
MATCH (e:Episode)-[:Asks]->(s:Slot)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE s
