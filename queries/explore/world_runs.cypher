// Runs with world models in the graph, with their numbers of looks, tool calls, refused calls and questions.
MATCH (e:Episode)-[:Wrote]->(w:Write)
RETURN e.run AS run,
       CAST(sum(CASE WHEN w.tool = 'observe' AND w.accepted = true THEN 1 ELSE 0 END) AS INT64) AS looks,
       count(*) AS writes, CAST(sum(CASE WHEN w.accepted = true THEN 0 ELSE 1 END) AS INT64) AS refused,
       count(DISTINCT e.id) AS questions
ORDER BY run;
