// What a run's agent was refused: each tool and reason with how often, and in how many questions.
// param run: text
MATCH (e:Episode)-[:Wrote]->(w:Write)
WHERE e.run = $run AND NOT w.accepted
RETURN w.tool AS tool, w.reason AS reason, count(*) AS times, count(DISTINCT e.id) AS questions
ORDER BY times DESC, tool, reason;
