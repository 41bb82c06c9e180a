// presence: a person is present (1) or absent (0) at two times, which changes if both times move by three seconds.
MATCH (m1:Moment)<-[:At]-(p:Person)-[:At]->(m2:Moment)
WHERE p.sequence = $sequence AND m1.seen IS NOT NULL AND m2.seen IS NOT NULL AND m2.frame >= m1.frame + $wait
  AND m1.image AND m2.image AND (m1.seen + m2.seen = 0 OR m1.seen = 1 AND NOT m1.ahead OR m2.seen = 1 AND NOT m2.ahead)
  AND (m1.later <> m1.seen AND m2.later IS NOT NULL OR m2.later <> m2.seen AND m1.later IS NOT NULL
       OR m1.earlier <> m1.seen AND m2.earlier IS NOT NULL OR m2.earlier <> m2.seen AND m1.earlier IS NOT NULL)
RETURN m1.track AS a, m1.frame AS t1, m2.frame AS t2, m1.seen AS first, m2.seen AS second ORDER BY a, t1, t2
