// presence: somebody described at t0 is present (seen = 1) or absent (0) at t1 and at t2; nothing unknown is read.
// Where the person is absent at both, the box to look at is the one at t0.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(p:Person)-[:`Is`]->(m1:Moment), (p)-[:`Is`]->(m2:Moment)
WHERE n.general
  AND m1.t >= m0.t + $wait AND m1.seen IS NOT NULL
  AND m2.t >= m1.t + $wait AND m2.seen IS NOT NULL
RETURN n.id AS name, m0.id AS at0, m1.id AS at1, m2.id AS at2,
       list_extract(['both times', 'only at the first time', 'only at the second time', 'neither time'],
                    4 - 2 * m1.seen - m2.seen) AS answer,
       n.anchor AS anchor,
       m0.clear AS evidence,
       m0.image AND m1.image AND m2.image AS image,
       (m1.seen + m2.seen > 0 AND (m1.seen = 0 OR m1.ahead) AND (m2.seen = 0 OR m2.ahead))
           OR (m1.seen + m2.seen = 0 AND m0.ahead) AS ahead
ORDER BY at0, at1, at2
