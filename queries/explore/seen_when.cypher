// All boxes that an agent gave for people in one question.
// param run: text
// param question: text
MATCH (e:Episode)-[:Holds]->(n:Entity)-[s:Sighted]->(o:Look)
WHERE e.id = concat($run, '/', $question)
RETURN s.frame AS frame, n.name AS entity, s.step AS step, o.number AS look, round(s.angle, 1) AS angle,
       round(s.box.x, 1) AS x, round(s.box.y, 1) AS y, round(s.box.w, 1) AS w, round(s.box.h, 1) AS h
ORDER BY frame, s.write, s.number, entity;
