// presence: somebody is present (seen = 1) or absent (0) at t1 and at t2.
// Nothing unknown is read. A candidate is such a pair with each description of the person that lies far enough before
// it (`described`). There are a hundred times as many of those: they are counted and judged without being listed here.
// ahead: whether the boxes to look at lie straight ahead, null where the person is absent at both, as the box at t0
// then decides.
// param sequence: text
MATCH (m1:Moment)<-[e1:At]-(p:Person)-[e2:At]->(m2:Moment)
WHERE m1.id >= $low AND m1.id < $high
  AND m2.id >= $low AND m2.id < $high
  AND m1.seen IS NOT NULL AND m2.seen IS NOT NULL AND m2.frame >= m1.frame + $wait
HINT (((m1 JOIN e1) JOIN p) JOIN e2) JOIN m2
RETURN m1.track AS a, m1.frame AS t1, m2.frame AS t2,
       list_extract(['both times', 'only at the first time', 'only at the second time', 'neither time'],
                    4 - 2 * m1.seen - m2.seen) AS answer,
       m1.image AND m2.image AS image,
       CASE WHEN m1.seen + m2.seen > 0 THEN (m1.seen = 0 OR m1.ahead) AND (m2.seen = 0 OR m2.ahead) END AS ahead
ORDER BY a, t1, t2
