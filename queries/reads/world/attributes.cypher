// Believed attributes of entities, with the frames at which they hold.
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)-[h:Has]->(o:Observation)
RETURN n.name AS who, h.name AS name, h.value AS value, h.number AS number, h.first AS first, h.last AS last,
       o.number AS look, h.write AS written, h.current AS current
ORDER BY first, who, name, value
