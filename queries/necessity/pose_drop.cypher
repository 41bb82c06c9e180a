// time.drop of change and later_pose: how many keyframes give the same person's pose, and how many poses there are.
// Of every moment that could be at t0, over every keyframe at which t1 could be.
// param sequence: text
MATCH (m0:Moment)<-[e0:At]-(p:Person)-[e:At]->(m:Moment)
WHERE m0.id >= $low AND m0.id < $high
  AND m.id >= $low AND m.id < $high
  AND m.frame >= m0.frame + $wait AND m.pose IS NOT NULL
HINT (((m0 JOIN e0) JOIN p) JOIN e) JOIN m
RETURN m0.track AS a, m0.frame AS t0, count(*) AS defined, count(DISTINCT m.pose) AS answers
ORDER BY a, t0
