// Delete the writes of a run's episodes, with the edges that end there.
MATCH (e:Episode)-[:Wrote]->(w:Write)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE w
