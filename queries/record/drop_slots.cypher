// Delete the slots of a run's episodes, with the edges that end there.
MATCH (e:Episode)-[:Asks]->(s:Slot)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE s
