// two_hop: two certain steps from somebody described lead to a person whose pose is the answer.
// stop_0, stop_1: the pose of a (two people early) and of b (one early). skip_1: of whom the second relation leads to
// from a. Where there is no pose, the outcome: empty, ambiguous or unknown.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)
WHERE n.id >= $low AND n.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND n.general AND c.id <> a.id AND c.pose IS NOT NULL
HINT (((((n JOIN d) JOIN a) JOIN s1) JOIN b) JOIN s2) JOIN c
OPTIONAL MATCH (a)-[k:Step]->(x:Moment)
WHERE x.id >= $low AND x.id < $high AND k.bit = s2.bit
HINT (a JOIN k) JOIN x
WITH n, d, a, s1, b, s2, c, coalesce(a.pose, 'unknown') AS stop_0, coalesce(b.pose, 'unknown') AS stop_1,
     coalesce(x.nowhere, x.pose,
              CASE WHEN x.id IS NULL AND bitwise_and(a.open, s2.bit) = 0 THEN 'empty' ELSE 'unknown' END) AS skip_1
RETURN n.id - $low AS name, a.frame AS t0, a.track AS a, s1.relation AS r1, b.track AS b, s2.relation AS r2,
       c.track AS c,
       c.pose AS answer,
       d.anchor AS anchor,
       a.clear AND b.clear AND c.clear AS evidence,
       a.image AS image,
       c.ahead AS ahead,
       stop_0, stop_1, NOT stop_0 IN ['unknown', c.pose] AND NOT stop_1 IN ['unknown', c.pose] AS hop_stop,
       skip_1, NOT skip_1 IN ['unknown', c.pose] AS hop_skip
ORDER BY name, r1, r2
