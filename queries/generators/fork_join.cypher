// fork_join: two steps lead from somebody described to two people, who together single out a fourth.
// A relation of each of them holds of that person, whose pose is the answer. The branch whose first relation comes
// first by its text is named first. stop_0 to stop_2: the poses of a, b and c. One of the latter two must differ, as
// the branches have no order.
// param sequence: text
MATCH (n:Name)-[e:Describes]->(a:Moment)-[s1:Leads]->(b:Moment)-[j:Joined]->(d:Moment), (a)-[s2:Leads]->(c:Moment)
WHERE n.id >= $low AND n.id < $high
  AND a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
  AND c.id >= $low AND c.id < $high
  AND d.id >= $low AND d.id < $high
  AND n.general AND s1.relation < s2.relation AND j.a = a.id AND j.c = c.id AND d.pose IS NOT NULL
HINT (((((((n JOIN e) JOIN a) JOIN s1) JOIN b) JOIN s2) JOIN c) JOIN j) JOIN d
RETURN n.id - $low AS name, a.frame AS t0, a.track AS a, s1.relation AS r1, b.track AS b, s2.relation AS r2,
       c.track AS c, j.r3 AS r3, j.r4 AS r4, d.track AS d,
       d.pose AS answer,
       e.anchor AS anchor,
       a.clear AND b.clear AND c.clear AND d.clear AS evidence,
       a.image AS image,
       d.ahead AS ahead,
       coalesce(a.pose, 'unknown') AS stop_0, coalesce(b.pose, 'unknown') AS stop_1,
       coalesce(c.pose, 'unknown') AS stop_2,
       coalesce(a.pose <> d.pose, false) AND (coalesce(b.pose <> d.pose, false) OR coalesce(c.pose <> d.pose, false))
         AS hop_stop
ORDER BY name, r1, r2, r3, r4
