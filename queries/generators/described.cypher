// described: a person in clear view who can be described. Questions of presence and of counts begin with such a person.
MATCH (n:Name)-[:Describes]->(m:Moment) WHERE n.sequence = $sequence AND n.general AND m.clear AND m.image
RETURN n.id AS name, m.track AS a, m.frame AS t0, m.ahead AS ahead ORDER BY name
