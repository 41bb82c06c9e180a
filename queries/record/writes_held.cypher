// Number of stored writes in each episode of a run. It is 0 if the first write was interrupted.
MATCH (e:Episode)
WHERE e.run = $run
OPTIONAL MATCH (e)-[:Wrote]->(w:Write)
RETURN e.question AS question, count(w.id) AS writes
ORDER BY question
