// time.shift of presence: the same person's presence when t1 and t2 move together by $by frames.
MATCH (n1:Moment)<-[s1:Shift]-(m1:Moment)<-[:`Is`]-(:Person)-[:`Is`]->(m2:Moment)-[s2:Shift]->(n2:Moment)
WHERE s1.by = $by AND s2.by = $by AND m2.t >= m1.t + $wait
  AND (m1.clear OR m1.absent) AND (m2.clear OR m2.absent)
RETURN m1.id AS at1, m2.id AS at2,
       CASE WHEN NOT (n1.clear OR n1.absent) OR NOT (n2.clear OR n2.absent) THEN 'unknown'
            WHEN n1.clear = m1.clear AND n2.clear = m2.clear THEN 'same'
            ELSE 'different' END AS outcome,
       CASE WHEN NOT (n1.clear OR n1.absent) OR NOT (n2.clear OR n2.absent) THEN NULL
            WHEN n1.clear AND n2.clear THEN 'both times'
            WHEN n1.clear THEN 'only at the first time'
            WHEN n2.clear THEN 'only at the second time'
            ELSE 'neither time' END AS answer
ORDER BY at1, at2
