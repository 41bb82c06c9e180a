// Attributes that an agent believes of its entities, each with its first and last frame.
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)-[h:Has]->(o:Observation)
RETURN n.name AS who, h.name AS name, h.value AS value, h.number AS number, h.first AS first, h.last AS last,
       o.number AS look, h.write AS written, h.current AS current
ORDER BY first, who, name, value
