// Where somebody is seen, boxes in stitched pixels. (Like the other reads that are asked seldom, it goes from the
// episode on and narrows nothing: a condition sends the engine to the whole table.)
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)-[s:Sighted]->(o:Observation)
RETURN n.name AS who, s.frame AS frame, s.box AS box, s.angle AS angle, o.number AS look, s.write AS written,
       s.current AS current
ORDER BY frame, written, who
