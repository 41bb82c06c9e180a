// All boxes that an agent gave for its entities in one question, including boxes that it later corrected.
// param run: text
// param question: text
MATCH (e:Episode)-[:Holds]->(n:Entity)-[s:Sighted]->(o:Observation)
WHERE e.id = concat($run, '/', $question)
RETURN s.frame AS frame, n.name AS entity, n.kind AS kind, n.node AS node, s.step AS step, o.number AS look,
       round(s.angle, 1) AS angle, round(s.box.x, 1) AS x, round(s.box.y, 1) AS y, round(s.box.w, 1) AS w,
       round(s.box.h, 1) AS h, s.current AS current
ORDER BY frame, s.write, entity;
