// All entities of an episode by name, with the plan node that each is assigned to ("" for none).
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)
RETURN n.name AS who, n.kind AS kind, coalesce(n.node, '') AS node, n.number AS number
ORDER BY who
