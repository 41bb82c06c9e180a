// How many writes of each of a run's episodes a graph holds; 0 of one whose first were interrupted.
MATCH (e:Episode)
WHERE e.run = $run
OPTIONAL MATCH (e)-[:Wrote]->(w:Write)
RETURN e.question AS question, count(w.id) AS writes
ORDER BY question
