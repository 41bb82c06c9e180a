// time.drop of fork_join: whom description and both first steps lead to at every keyframe at which they are two.
// Whom b and c single out together then is no part of the graph.
// param sequence: text
MATCH (p:Description)-[f:Fits]->(a:Moment)-[s1:Leads]->(b:Moment), (a)-[s2:Leads]->(c:Moment)
WHERE p.id >= $low AND p.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND b.id <> c.id AND s1.relation < s2.relation
HINT (((((p JOIN f) JOIN a) JOIN s1) JOIN b) JOIN s2) JOIN c
RETURN p.id - $low AS description, a.frame AS frame, s1.relation AS r1, s2.relation AS r2, a.track AS a, b.track AS b,
       c.track AS c
ORDER BY description, frame, r1, r2
