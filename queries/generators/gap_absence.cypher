// gap, an absence: somebody described at t0 is present at every keyframe until the first absence after t0.
// The seconds lie between the last frame before it and the first one after it.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(m0:Moment)<-[e0:At]-(p:Person)-[e1:Leaves]->(g:Absence)
WHERE n.id >= $low AND n.id < $high
  AND m0.id >= $low AND m0.id < $high
  AND g.id >= $low AND g.id < $high
  AND n.general AND m0.frame >= g.present_from AND g.leaves >= m0.frame + $wait AND g.returns >= g.leaves + $gap
HINT (((((n JOIN d) JOIN m0) JOIN e0) JOIN p) JOIN e1) JOIN g
RETURN n.id - $low AS name, m0.frame AS t0, m0.track AS a, g.leaves AS leaves, g.returns AS returns,
       (g.returns - g.leaves) / $fps AS value,
       d.anchor AS anchor,
       m0.clear AND g.clear AS evidence,
       m0.image AND g.image AS image,
       g.ahead AS ahead
ORDER BY a, t0, leaves
