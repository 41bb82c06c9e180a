// All entities of an episode, sorted by name, with the plan node of each ("" if the entity has none).
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)
RETURN n.name AS who, n.kind AS kind, coalesce(n.node, '') AS node, n.number AS number
ORDER BY who
