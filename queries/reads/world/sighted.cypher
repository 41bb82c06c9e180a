// Where somebody is seen, boxes in stitched pixels. (Like the other reads of an episode it narrows nothing: from the
// episode on that is a millisecond, while a condition sends the engine to the whole table.)
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)-[s:Sighted]->(:Observation)
RETURN n.name AS who, s.frame AS frame, s.box AS box, s.angle AS angle, s.write AS written, s.current AS current
ORDER BY who, frame, written
