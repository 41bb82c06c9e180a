// Takes away what a run's episodes hold in Entity, with the edges that end there.
MATCH (e:Episode)-[:Holds]->(n:Entity)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE n
