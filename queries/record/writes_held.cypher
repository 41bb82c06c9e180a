// Number of stored writes of each of a run's episodes; 0 if its first write was interrupted.
MATCH (e:Episode)
WHERE e.run = $run
OPTIONAL MATCH (e)-[:Wrote]->(w:Write)
RETURN e.question AS question, count(w.id) AS writes
ORDER BY question
