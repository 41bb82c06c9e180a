// gap, a count: with how many different people somebody described at t1 is in a relation from t1 to t2.
// All of that time it is known with whom. Everybody counted must be seen together with the target before t2, and
// whoever may be in the relation between two keyframes must be one of them.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(m1:Moment)-[b:Begins]->(e:Encounter)-[w:Meets]->(q:Person),
      (m1)<-[e1:At]-(p:Person)-[e2:At]->(m2:Moment)
WHERE n.id >= $low AND n.id < $high
  AND m1.id >= $low AND m1.id < $high
  AND m2.id >= $low AND m2.id < $high
  AND e.id >= $low AND e.id < $high
  AND n.general AND m2.frame >= m1.frame + $later AND m2.frame <= e.until
HINT (((((((((n JOIN d) JOIN m1) JOIN b) JOIN e) JOIN e1) JOIN p) JOIN e2) JOIN m2) JOIN w) JOIN q
WITH n.id AS name, d.anchor AS anchor, m1.frame AS t1, m1.track AS a, m1.clear AS clear, m1.image AS image,
     m1.ahead AS ahead, m2.frame AS t2, e.id AS encounter, e.relation AS r1,
     sum(CASE WHEN w.met <= m2.frame THEN 1 ELSE 0 END) AS people,
     sum(CASE WHEN w.maybe <= m2.frame AND (w.met IS NULL OR w.met > m2.frame) THEN 1 ELSE 0 END) AS others,
     sum(CASE WHEN w.clear_from <= m2.frame THEN 1 ELSE 0 END) AS seen,
     sum(CASE WHEN w.clear_from <= m2.frame AND w.image THEN 1 ELSE 0 END) AS with_image
WHERE people >= $least AND others = 0
RETURN name - $low AS name, t1, a, t2, encounter - $low AS encounter, r1,
       CAST(people AS DOUBLE) AS value,
       anchor,
       clear AND seen = people AS evidence,
       image AND with_image = people AS image,
       ahead
ORDER BY name, t2, r1
