// action_search: two steps lead to a person at t0 who later starts an action in another direction.
// It is the first stable segment of the action after t0, seen more than $turn degrees away from the direction at t0.
// skip_1_person: whom the second step leads to from a. Where that is nobody, skip_1 is the outcome.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[s2:Leads]->(c:Moment)<-[e0:At]-(p:Person)
      -[e1:Acts]->(s:Segment)
WHERE n.id >= $low AND n.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND s.id >= $low AND s.id < $high
  AND n.general AND c.id <> a.id
  AND s.start >= c.frame + $search AND s.quiet_from <= c.frame
  AND abs(s.angle - c.angle) > $turn AND abs(s.angle - c.angle) < 360 - $turn
HINT (((((((((n JOIN d) JOIN a) JOIN s1) JOIN b) JOIN s2) JOIN c) JOIN e0) JOIN p) JOIN e1) JOIN s
OPTIONAL MATCH (a)-[k:Step]->(x:Moment)
WHERE x.id >= $low AND x.id < $high AND k.bit = s2.bit
HINT (a JOIN k) JOIN x
RETURN n.id - $low AS name, a.frame AS t0, a.track AS a, s1.relation AS r1, b.track AS b, s2.relation AS r2,
       c.track AS c, s.id - $low AS segment,
       d.anchor AS anchor,
       a.clear AND b.clear AND c.clear AND s.first_clear AS evidence,
       a.image AND s.first_image AS image,
       s.first_ahead AS ahead,
       x.track AS skip_1_person,
       coalesce(x.nowhere, CASE WHEN x.id IS NULL AND bitwise_and(a.open, s2.bit) = 0 THEN 'empty' ELSE 'unknown' END)
         AS skip_1
ORDER BY name, segment, r1, r2
