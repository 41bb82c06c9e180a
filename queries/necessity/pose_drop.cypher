// time.drop of change and later_pose: every keyframe at which t1 could be, for every moment that could be at t0, and
// how many different poses are known there.
MATCH (m0:Moment)<-[:`Is`]-(:Person)-[:`Is`]->(m:Moment)
WHERE m.t >= m0.t + $wait AND m.pose IS NOT NULL
RETURN m0.id AS at0, count(*) AS defined, count(DISTINCT m.pose) AS answers
ORDER BY at0
