// Where somebody is seen, boxes in stitched pixels, the newest write last.
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)-[s:Sighted]->(:Observation)
WITH n.name AS who, s.frame AS frame, s.box AS box, s.angle AS angle, s.write AS written, s.current AS current
WHERE current AND who = $who
RETURN frame, box, angle, written
ORDER BY frame, written
