// time.drop of presence: every pair of keyframes, equally far apart, at which t1 and t2 could be.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(p:Person)-[:`Is`]->(m1:Moment), (p)-[:`Is`]->(m2:Moment)
WHERE n.general
  AND m1.t >= m0.t + $wait AND m1.seen IS NOT NULL
  AND m2.t >= m1.t + $wait AND m2.seen IS NOT NULL
RETURN m0.id AS at0, m2.t - m1.t AS spacing, count(*) AS defined, count(DISTINCT 2 * m1.seen + m2.seen) AS answers
ORDER BY at0, spacing
