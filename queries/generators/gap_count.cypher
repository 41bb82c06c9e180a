// gap, a count: with how many different people somebody described at t1 is in a relation from t1 to t2. All of that
// time it is known with whom. Everybody counted must be seen together with the target before t2; whoever may be in the
// relation between two keyframes must be one of them.
MATCH (:Description)-[n:Names]->(m1:Moment)-[:Keeps]->(c:Company)-[w:Meets]->(:Person),
      (m1)<-[:`Is`]-(:Person)-[:`Is`]->(m2:Moment)
WHERE n.general AND m2.t >= m1.t + $later AND m2.t <= c.until
WITH n.id AS name, n.anchor AS anchor, m1.id AS at0, m1.clear AS clear, m1.image AS image, m1.ahead AS ahead,
     m2.id AS at2, c.id AS company, c.relation AS r1,
     sum(CASE WHEN w.met <= m2.t THEN 1 ELSE 0 END) AS people,
     sum(CASE WHEN w.maybe <= m2.t AND (w.met IS NULL OR w.met > m2.t) THEN 1 ELSE 0 END) AS others,
     sum(CASE WHEN w.seen <= m2.t THEN 1 ELSE 0 END) AS seen,
     sum(CASE WHEN w.seen <= m2.t AND w.image THEN 1 ELSE 0 END) AS shown
WHERE people >= $least AND others = 0
RETURN name, at0, at2, company, r1,
       CAST(people AS DOUBLE) AS value,
       anchor,
       clear AND seen = people AS evidence,
       image AND shown = people AS image,
       ahead
ORDER BY name, r1, at2
