// Whom each name fits, whether it is chosen for questions in general, and whether it is an anchor.
// It fits for certain while nobody else could be meant, and every condition is needed: two people could be meant
// without it. Conditions of a name are its places 1, 2 and 4, and `met` is their sum.
// param sequence: text
MATCH (n:Name)-[u:Uses]->(c:Condition)<-[s:Satisfies]-(m:Moment)
WHERE n.id >= $low AND n.id < $high
  AND c.id >= $low AND c.id < $high
  AND m.id >= $low AND m.id < $high
WITH n.id AS name, n.general AS general, n.size AS size, n.people AS people, m.id AS moment, sum(u.place) AS met,
     sum(CASE WHEN s.certain = true THEN u.place ELSE 0 END) AS certain
WITH name, general, size, people, moment, met, certain, CASE size WHEN 1 THEN 1 WHEN 2 THEN 3 ELSE 7 END AS full
WITH name, general, size, people, sum(CASE WHEN met = full THEN 1 ELSE 0 END) AS could,
     sum(CASE WHEN certain = full THEN 1 ELSE 0 END) AS fit, max(CASE WHEN met = full THEN moment ELSE 0 END) AS moment,
     max(CASE WHEN full - met = 1 THEN 1 ELSE 0 END) + max(CASE WHEN full - met = 2 THEN 1 ELSE 0 END)
       + max(CASE WHEN full - met = 4 THEN 1 ELSE 0 END) AS needed
RETURN name - $low AS name, general, moment - $low AS moment,
       could = 1 AND fit = 1 AND ((size = 1 AND people >= 2) OR (size > 1 AND needed = size)) AS anchor
ORDER BY name
