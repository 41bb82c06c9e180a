// All calls of an agent's tools in one question, in order. A refused call has the reason of the refusal.
// param run: text
// param question: text
MATCH (e:Episode)-[:Wrote]->(w:Write)
WHERE e.id = concat($run, '/', $question)
RETURN w.number AS number, w.step AS step, w.tool AS tool, w.accepted AS accepted, w.reason AS reason,
       w.arguments AS arguments
ORDER BY number;
