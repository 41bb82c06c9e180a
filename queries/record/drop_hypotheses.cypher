// Delete the hypotheses of a run's episodes, with the edges that end there.
MATCH (e:Episode)-[:Ranks]->(h:Hypothesis)
WHERE e.run = $run AND ($whole OR list_contains($questions, e.question))
DETACH DELETE h
