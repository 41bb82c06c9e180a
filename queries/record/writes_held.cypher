// How many writes of each of a run's episodes a graph holds.
MATCH (e:Episode)-[:Wrote]->(w:Write)
WHERE e.run = $run
RETURN e.question AS question, count(*) AS writes
ORDER BY question
