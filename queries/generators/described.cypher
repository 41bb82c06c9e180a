// Descriptions of people at t0: with `presence`, the candidates of the template presence.
// param sequence: text
MATCH (n:Name)-[d:Describes]->(m0:Moment)
WHERE n.id >= $low AND n.id < $high
  AND m0.id >= $low AND m0.id < $high
  AND n.general
RETURN n.id - $low AS name, m0.frame AS t0, m0.track AS a,
       d.anchor AS anchor,
       m0.clear AS evidence,
       m0.image AS image,
       m0.ahead AS ahead
ORDER BY a, t0
