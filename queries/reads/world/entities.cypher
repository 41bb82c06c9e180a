// Everybody of an episode, by name, and the node of the plan that each is said to be ("" for none).
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)
RETURN n.name AS who, coalesce(n.node, '') AS node
ORDER BY who
