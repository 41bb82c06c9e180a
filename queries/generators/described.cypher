// Who is described at which keyframe: the other half of presence's candidates.
MATCH (:Description)-[n:Names]->(m0:Moment)
WHERE n.general
RETURN n.id AS name, m0.id AS at0,
       n.anchor AS anchor,
       m0.clear AS evidence,
       m0.image AS image,
       m0.ahead AS ahead
ORDER BY at0
