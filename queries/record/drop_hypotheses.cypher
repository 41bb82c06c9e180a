// Delete the hypotheses of a run's episodes, together with their edges.
MATCH (e:Episode)-[:Ranks]->(h:Hypothesis)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE h
