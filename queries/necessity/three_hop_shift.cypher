// time.shift of three_hop: the answer with description and hops read $by frames later.
// Where there is none, the outcome. Only of candidates that pass anchor, evidence, image, view.ahead and hop.stop,
// where a keyframe lies $by frames later.
// param sequence: text
// $by: plus or minus 15 times the rule shift_s, plus where it is not passed. Any other number finds no rows.
// param by: integer = 45
MATCH (n:Name)-[e:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)-[s3:Leads]->(d:Moment),
      (n)-[v:Moved]->(a2:Moment)
WHERE n.id >= $low AND n.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND d.id >= $low AND d.id < $high
  AND a2.id >= $low AND a2.id < $high
  AND n.general AND c.id <> a.id AND d.id <> a.id AND d.id <> b.id AND d.pose IS NOT NULL AND v.by = $by
  AND e.anchor AND a.clear AND b.clear AND c.clear AND d.clear AND a.image AND NOT d.ahead
  AND a.pose <> d.pose AND b.pose <> d.pose AND c.pose <> d.pose
HINT (((((((((n JOIN e) JOIN v) JOIN a) JOIN s1) JOIN b) JOIN s2) JOIN c) JOIN s3) JOIN d) JOIN a2
OPTIONAL MATCH (a2)-[k1:Step]->(b2:Moment)
WHERE b2.id >= $low AND b2.id < $high AND k1.bit = s1.bit
HINT (a2 JOIN k1) JOIN b2
OPTIONAL MATCH (b2)-[k2:Step]->(c2:Moment)
WHERE c2.id >= $low AND c2.id < $high AND k2.bit = s2.bit
HINT (b2 JOIN k2) JOIN c2
OPTIONAL MATCH (c2)-[k3:Step]->(d2:Moment)
WHERE d2.id >= $low AND d2.id < $high AND k3.bit = s3.bit
HINT (c2 JOIN k3) JOIN d2
RETURN n.id - $low AS name, s1.relation AS r1, s2.relation AS r2, s3.relation AS r3,
       CASE WHEN a2.nowhere IS NOT NULL THEN a2.nowhere
            WHEN b2.id IS NULL THEN CASE WHEN bitwise_and(a2.open, s1.bit) > 0 THEN 'unknown' ELSE 'empty' END
            WHEN b2.nowhere IS NOT NULL THEN b2.nowhere
            WHEN c2.id IS NULL THEN CASE WHEN bitwise_and(b2.open, s2.bit) > 0 THEN 'unknown' ELSE 'empty' END
            WHEN c2.id = a2.id THEN 'empty'
            WHEN c2.nowhere IS NOT NULL THEN c2.nowhere
            WHEN d2.id IS NULL THEN CASE WHEN bitwise_and(c2.open, s3.bit) > 0 THEN 'unknown' ELSE 'empty' END
            WHEN d2.id IN [a2.id, b2.id] THEN 'empty'
            ELSE coalesce(d2.nowhere, d2.pose, 'unknown') END AS answer
ORDER BY name, r1, r2, r3
