// time.drop of presence: every pair of keyframes, equally far apart, at which t1 and t2 could be.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(p:Person)-[:`Is`]->(m1:Moment), (p)-[:`Is`]->(m2:Moment)
WHERE n.general
  AND m1.t >= m0.t + $wait AND (m1.clear OR m1.absent)
  AND m2.t >= m1.t + $wait AND (m2.clear OR m2.absent)
WITH m0.id AS at0, m2.t - m1.t AS spacing,
     CASE WHEN m1.clear THEN 2 ELSE 0 END + CASE WHEN m2.clear THEN 1 ELSE 0 END AS answer
RETURN at0, spacing, count(*) AS defined, CASE WHEN min(answer) = max(answer) THEN 1 ELSE 2 END AS answers
ORDER BY at0, spacing
