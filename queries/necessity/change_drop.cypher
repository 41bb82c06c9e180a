// time.drop of change: every keyframe at which t1 could be, and how many different poses are known there.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(:Person)-[:`Is`]->(m:Moment)
WHERE n.poseless AND m.t >= m0.t + $wait AND m.pose IS NOT NULL
RETURN m0.id AS at0, count(*) AS defined, count(DISTINCT m.pose) AS answers
ORDER BY at0
