// For the read presence and the events leaves and returns: the columns of the panorama that each look showed.
MATCH (:Episode {id: $scope})-[:Made]->(o:Observation)
RETURN o.frame AS frame, o.left AS edge, o.width AS width, o.number AS look, o.angle AS angle
ORDER BY frame, edge, width
