// Every stored step that leads to a person.
// param sequence: text
MATCH (a:Moment)-[s:Leads]->(b:Moment)
WHERE a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
RETURN a.frame AS frame, a.track AS source, b.track AS target, s.relation AS relation
ORDER BY frame, source, relation
