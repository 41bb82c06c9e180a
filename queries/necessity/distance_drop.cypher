// time.drop of distance: every keyframe at which t1 could be, and how many different answers are known there.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(:Person)-[:`Is`]->(m:Moment)
WHERE n.general AND m.t >= m0.t + $wait AND m0.distance IS NOT NULL AND m.seen IS NOT NULL
WITH m0.id AS at0,
     CASE WHEN m.seen = 0 THEN 'not in view'
          WHEN m0.distance - m.distance >= $changed THEN 'closer to the robot'
          WHEN m.distance - m0.distance >= $changed THEN 'farther from the robot'
          WHEN abs(m0.distance - m.distance) < $same THEN 'about the same distance' END AS answer
WHERE answer IS NOT NULL
RETURN at0, count(*) AS defined, count(DISTINCT answer) AS answers
ORDER BY at0
