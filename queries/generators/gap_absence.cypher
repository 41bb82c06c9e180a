// gap, an absence: somebody described at t0 is present at every keyframe until the first absence after t0.
// What is asked lies between the last frame before it and the first one after it.
MATCH (:Description)-[n:Names]->(m0:Moment)<-[:`Is`]-(:Person)-[:Leaves]->(g:Absence)
WHERE n.general AND m0.t >= g.present_from AND g.leaves >= m0.t + $wait AND g.returns >= g.leaves + $gap
RETURN n.id AS name, m0.id AS at0, g.leaves AS leaves, g.returns AS returns,
       (g.returns - g.leaves) / $fps AS value,
       n.anchor AS anchor,
       m0.clear AND g.clear AS evidence,
       m0.image AND g.image AS image,
       g.ahead AS ahead
ORDER BY at0, leaves
