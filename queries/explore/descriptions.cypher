// The description chosen for each person at each keyframe. The generators' queries refer to it by the column `name`.
// param sequence: text
MATCH (p:Description)<-[:Of]-(n:Name)-[d:Describes]->(m:Moment)
WHERE p.id >= $low AND p.id < $high
  AND n.id >= $low AND n.id < $high
  AND m.id >= $low AND m.id < $high
RETURN n.id - $low AS name, m.frame AS frame, m.track AS track, d.anchor AS anchor, p.conditions AS conditions
ORDER BY name
