// Delete the hypotheses of a run's episodes, together with their edges.
MATCH (e:Episode)-[:Ranks]->(h:Hypothesis)
WHERE e.run = $run
DETACH DELETE h
