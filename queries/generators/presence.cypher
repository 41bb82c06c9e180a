// presence: somebody described at t0 is present or absent at t1 and at t2; nothing unknown is read.
// Where the person is absent at both, the box to look at is the one at t0.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(p:Person)-[:`Is`]->(m1:Moment), (p)-[:`Is`]->(m2:Moment)
WHERE n.general
  AND m1.t >= m0.t + $wait AND (m1.clear OR m1.absent)
  AND m2.t >= m1.t + $wait AND (m2.clear OR m2.absent)
RETURN n.id AS name, m0.id AS at0, m1.id AS at1, m2.id AS at2,
       CASE WHEN m1.clear AND m2.clear THEN 'both times'
            WHEN m1.clear THEN 'only at the first time'
            WHEN m2.clear THEN 'only at the second time'
            ELSE 'neither time' END AS answer,
       n.anchor AS anchor,
       m0.clear AS evidence,
       m0.image AND m1.image AND m2.image AS image,
       CASE WHEN m1.clear OR m2.clear THEN (m1.absent OR m1.ahead) AND (m2.absent OR m2.ahead)
            ELSE m0.ahead END AS ahead
ORDER BY at0, at1, at2
