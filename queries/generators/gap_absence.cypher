// gap_absence: a described person is present at every keyframe until the first absence from view.
MATCH (n:Name)-[:Describes]->(m0:Moment)<-[:At]-(p:Person)-[:Leaves]->(g:Absence)
WHERE p.sequence = $sequence AND n.general AND m0.frame >= g.present_from AND g.leaves >= m0.frame + $wait
  AND g.returns >= g.leaves + $gap AND m0.clear AND g.clear AND m0.image AND g.image AND NOT g.ahead
RETURN n.id AS name, m0.frame AS t0, m0.track AS a, g.leaves AS leaves, g.returns AS returns,
       (g.returns - g.leaves) / $fps AS value ORDER BY name, leaves
