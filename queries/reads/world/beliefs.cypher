// All that is believed in an episode, one row each: a sighting has no name, a relation has an other one, an attribute
// neither. (What narrows the pattern comes after it: with an equality inside, the engine begins at the whole table.)
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)-[r:Sighted|Has|Related]->(o:Observation:Entity)
WITH n.name AS id, coalesce(o.name, '') AS other, coalesce(r.name, '') AS name, coalesce(r.value, '') AS value,
     coalesce(r.number, 0.0) AS number, coalesce(r.first, r.frame) AS first, coalesce(r.last, r.frame) AS last,
     r.current AS current
WHERE current
