// Everybody of an episode, by name, and the node of the plan that each is said to be ("" for none).
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)
RETURN n.name AS who, n.kind AS kind, coalesce(n.node, '') AS node, n.number AS number
ORDER BY who
