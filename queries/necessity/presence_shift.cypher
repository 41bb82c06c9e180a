// time.shift of presence: the same person's presence when t1 and t2 move together by $by frames.
// Pairs whose presence is unknown after the move are left out.
MATCH (n1:Moment)<-[s1:Shift]-(m1:Moment)<-[:`Is`]-(:Person)-[:`Is`]->(m2:Moment)-[s2:Shift]->(n2:Moment)
WHERE s1.by = $by AND s2.by = $by AND m2.t >= m1.t + $wait
  AND m1.seen IS NOT NULL AND m2.seen IS NOT NULL AND n1.seen IS NOT NULL AND n2.seen IS NOT NULL
RETURN m1.id AS at1, m2.id AS at2,
       list_extract(['both times', 'only at the first time', 'only at the second time', 'neither time'],
                    4 - 2 * n1.seen - n2.seen) AS answer
ORDER BY at1, at2
