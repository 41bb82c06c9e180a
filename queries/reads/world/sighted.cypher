// Sightings of entities, with boxes in stitched pixels. (Like other rare reads, it begins at the episode and has no
// conditions, because a condition makes the engine scan the whole table.)
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)-[s:Sighted]->(o:Observation)
RETURN n.name AS who, s.frame AS frame, s.box AS box, s.angle AS angle, o.number AS look, s.write AS written,
       s.current AS current
ORDER BY frame, written, who
