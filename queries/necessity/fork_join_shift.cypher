// time.shift of fork_join: whom description and both first steps lead to $by frames later.
// Where that is nobody, the outcome. Whom b and c single out together then is no part of the graph.
// param sequence: text
// $by: plus or minus 15 times the rule shift_s, plus where it is not passed. Any other number finds no rows.
// param by: integer = 45
MATCH (n:Name)-[e:Describes]->(a:Moment)-[s1:Leads]->(b:Moment), (a)-[s2:Leads]->(c:Moment), (n)-[v:Moved]->(a2:Moment)
WHERE n.id >= $low AND n.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND a2.id >= $low AND a2.id < $high
  AND n.general AND b.id <> c.id AND s1.relation < s2.relation AND v.by = $by
  AND e.anchor AND a.clear AND b.clear AND c.clear AND a.image
HINT (((((((n JOIN e) JOIN v) JOIN a) JOIN s1) JOIN b) JOIN s2) JOIN c) JOIN a2
OPTIONAL MATCH (a2)-[k1:Step]->(b2:Moment)
WHERE b2.id >= $low AND b2.id < $high AND k1.bit = s1.bit
HINT (a2 JOIN k1) JOIN b2
OPTIONAL MATCH (a2)-[k2:Step]->(c2:Moment)
WHERE c2.id >= $low AND c2.id < $high AND k2.bit = s2.bit
HINT (a2 JOIN k2) JOIN c2
WITH n, s1, s2, a2, b2, c2,
     CASE WHEN b2.id IS NULL AND a2.nowhere IS NULL AND bitwise_and(a2.open, s1.bit) = 0 THEN 'empty'
          ELSE coalesce(a2.nowhere, b2.nowhere, 'unknown') END AS b_outcome,
     CASE WHEN c2.id IS NULL AND a2.nowhere IS NULL AND bitwise_and(a2.open, s2.bit) = 0 THEN 'empty'
          ELSE coalesce(a2.nowhere, c2.nowhere, 'unknown') END AS c_outcome
RETURN n.id - $low AS name, s1.relation AS r1, s2.relation AS r2, a2.track AS a, b2.track AS b, c2.track AS c,
       coalesce(a2.nowhere, 'unknown') AS a_outcome, b_outcome, c_outcome
ORDER BY name, r1, r2
