// All that is believed in an episode, one row each: of a sighting the frame, of a relation the other one.
// (What narrows the pattern comes after it: with an equality inside, the engine begins at the whole table.)
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)-[r:Sighted|Has|Related]->(o:Observation:Entity)
WITH n.name AS id, o.name AS other, r
WHERE r.current
