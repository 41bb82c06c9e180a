// Refused calls of the agent's tools in a run, by tool and reason: number of calls, and number of questions with them.
// param run: text
MATCH (e:Episode)-[:Wrote]->(w:Write)
WHERE e.run = $run AND NOT w.accepted
RETURN w.tool AS tool, w.reason AS reason, count(*) AS times, count(DISTINCT e.id) AS questions
ORDER BY times DESC, tool, reason;
