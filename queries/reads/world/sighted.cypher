// Sightings of an episode's entities, with boxes in stitched pixels. The statement begins at the episode and lacks
// conditions, because a condition would make the engine scan the whole table.
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)-[s:Sighted]->(o:Observation)
RETURN n.name AS who, s.frame AS frame, s.box AS box, s.angle AS angle, o.number AS look, s.write AS written,
       s.current AS current
ORDER BY frame, written, who
