// Takes away what a run's episodes hold in Write, with the edges that end there.
MATCH (e:Episode)-[:Wrote]->(w:Write)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE w
