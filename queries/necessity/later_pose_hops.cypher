// hop.stop and hop.skip of later_pose: the poses at t1 of a and b, and of whom the second step leads to from a.
// A person's moments have numbers in a row, one per keyframe, so a_then is as far on from a as m1 is from c.
// Of somebody who is absent at t1 nothing is read. Only of candidates that pass anchor, evidence, image, view.ahead.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)<-[e0:At]-(p:Person)
      -[e1:At]->(m1:Moment)
WHERE n.id >= $low AND n.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND m1.id >= $low AND m1.id < $high
  AND n.general AND c.id <> a.id AND m1.frame >= c.frame + $later AND m1.pose <> c.pose
  AND d.anchor AND a.clear AND b.clear AND c.clear AND m1.clear AND a.image AND m1.image AND NOT m1.ahead
HINT (((((((((n JOIN d) JOIN a) JOIN s1) JOIN b) JOIN s2) JOIN c) JOIN e0) JOIN p) JOIN e1) JOIN m1
OPTIONAL MATCH (a)-[k:Step]->(x:Moment)
WHERE x.id >= $low AND x.id < $high AND k.bit = s2.bit
HINT (a JOIN k) JOIN x
WITH n.id AS name, m1.frame AS t1, m1.pose AS pose, s1.relation AS r1, s2.relation AS r2, a.id + m1.id - c.id AS a_then,
     b.id + m1.id - c.id AS b_then,
     CASE WHEN x.nowhere IS NULL THEN coalesce(x.id + m1.id - c.id, -1) ELSE -1 END AS x_then,
     CASE WHEN x.id IS NULL AND bitwise_and(a.open, s2.bit) = 0 THEN 'empty' ELSE coalesce(x.nowhere, 'unknown') END
       AS outcome
OPTIONAL MATCH (a1:Moment)
WHERE a1.id >= $low AND a1.id < $high AND a1.id = a_then
WITH name, t1, pose, r1, r2, b_then, x_then, outcome,
     CASE WHEN a1.seen = 0 THEN 'empty' ELSE coalesce(a1.pose, 'unknown') END AS stop_0
OPTIONAL MATCH (b1:Moment)
WHERE b1.id >= $low AND b1.id < $high AND b1.id = b_then
WITH name, t1, pose, r1, r2, x_then, outcome, stop_0,
     CASE WHEN b1.seen = 0 THEN 'empty' ELSE coalesce(b1.pose, 'unknown') END AS stop_1
OPTIONAL MATCH (x1:Moment)
WHERE x1.id >= $low AND x1.id < $high AND x1.id = x_then
WITH name, t1, pose, r1, r2, stop_0, stop_1,
     CASE WHEN x1.seen = 0 THEN 'empty' ELSE coalesce(x1.pose, outcome) END AS skip_1
RETURN name - $low AS name, t1, r1, r2,
       stop_0, stop_1, NOT stop_0 IN ['unknown', pose] AND NOT stop_1 IN ['unknown', pose] AS hop_stop,
       skip_1, NOT skip_1 IN ['unknown', pose] AS hop_skip
ORDER BY name, t1, r1, r2
