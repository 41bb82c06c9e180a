// three_hop: as two_hop, one step farther to a fourth person.
// skip_1 leaves out the first step (x, then y), skip_2 the second (z). Whoever comes back to a finds nobody.
// param sequence: text
MATCH (n:Name)-[e:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)-[s3:Leads]->(d:Moment)
WHERE n.id >= $low AND n.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND d.id >= $low AND d.id < $high
  AND n.general AND c.id <> a.id AND d.id <> a.id AND d.id <> b.id AND d.pose IS NOT NULL
HINT (((((((n JOIN e) JOIN a) JOIN s1) JOIN b) JOIN s2) JOIN c) JOIN s3) JOIN d
OPTIONAL MATCH (a)-[k2:Step]->(x:Moment)
WHERE x.id >= $low AND x.id < $high AND k2.bit = s2.bit
HINT (a JOIN k2) JOIN x
OPTIONAL MATCH (x)-[k3:Step]->(y:Moment)
WHERE y.id >= $low AND y.id < $high AND k3.bit = s3.bit
HINT (x JOIN k3) JOIN y
OPTIONAL MATCH (b)-[k:Step]->(z:Moment)
WHERE z.id >= $low AND z.id < $high AND k.bit = s3.bit
HINT (b JOIN k) JOIN z
WITH n, e, a, s1, b, s2, c, s3, d, coalesce(a.pose, 'unknown') AS stop_0, coalesce(b.pose, 'unknown') AS stop_1,
     coalesce(c.pose, 'unknown') AS stop_2,
     coalesce(x.nowhere, CASE WHEN y.id = a.id THEN 'empty' END, y.nowhere, y.pose,
              CASE WHEN y.id IS NULL AND bitwise_and(coalesce(x.open, a.open),
                                                     CASE WHEN x.id IS NULL THEN s2.bit ELSE s3.bit END) = 0
                   THEN 'empty' ELSE 'unknown' END) AS skip_1,
     coalesce(CASE WHEN z.id = a.id THEN 'empty' END, z.nowhere, z.pose,
              CASE WHEN z.id IS NULL AND bitwise_and(b.open, s3.bit) = 0 THEN 'empty' ELSE 'unknown' END) AS skip_2
RETURN n.id - $low AS name, a.frame AS t0, a.track AS a, s1.relation AS r1, b.track AS b, s2.relation AS r2,
       c.track AS c, s3.relation AS r3, d.track AS d,
       d.pose AS answer,
       e.anchor AS anchor,
       a.clear AND b.clear AND c.clear AND d.clear AS evidence,
       a.image AS image,
       d.ahead AS ahead,
       stop_0, stop_1, stop_2,
       NOT stop_0 IN ['unknown', d.pose] AND NOT stop_1 IN ['unknown', d.pose] AND NOT stop_2 IN ['unknown', d.pose]
         AS hop_stop,
       skip_1, skip_2, NOT skip_1 IN ['unknown', d.pose] AND NOT skip_2 IN ['unknown', d.pose] AS hop_skip
ORDER BY name, r1, r2, r3
