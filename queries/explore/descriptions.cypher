// Return the descriptions of people at keyframes. The rows of generators name a description by its `name`.
MATCH (n:Name)-[:Describes]->(m:Moment)
WHERE n.sequence = $sequence
RETURN n.id AS name, m.frame AS frame, m.track AS track, n.conditions AS conditions
ORDER BY name
