// gap, a count: with how many different people somebody described at t1 is in a relation from t1 to t2. All of that
// time it is known with whom. Everybody counted must be seen together with the target before t2.
MATCH (:Description)-[n:Names]->(m1:Moment)-[:Keeps]->(c:Company)-[w:Meets]->(:Person),
      (m1)<-[:`Is`]-(:Person)-[:`Is`]->(m2:Moment)
WHERE n.general AND m2.t >= m1.t + $later AND m2.t <= c.until AND w.met <= m2.t
WITH n.id AS name, n.anchor AS anchor, m1.id AS at0, m1.clear AS clear, m1.image AS image, m1.ahead AS ahead,
     m2.id AS at2, c.id AS company, c.relation AS r1,
     count(*) AS people,
     min(CASE WHEN w.seen <= m2.t THEN 1 ELSE 0 END) AS seen,
     min(CASE WHEN w.seen <= m2.t AND NOT w.image THEN 0 ELSE 1 END) AS shown
WHERE people >= $least
RETURN name, at0, at2, company, r1,
       CAST(people AS DOUBLE) AS value,
       anchor,
       clear AND seen = 1 AS evidence,
       image AND shown = 1 AS image,
       ahead
ORDER BY name, r1, at2
