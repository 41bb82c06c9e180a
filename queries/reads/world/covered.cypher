// presence, leaves, returns: frames of which the whole panorama is observed. Where a crop ends, another one must go on,
// where that is so for all crops of a frame, no column is left out.
MATCH (:Episode {id: $scope})-[:Made]->(o:Observation)
WITH collect({frame: o.frame, begin: o.left, width: o.width}) AS looks
UNWIND looks AS l
UNWIND looks AS k
WITH l.frame AS frame, l.begin AS edge, l.width AS wide, k.frame AS other, k.begin AS begin, k.width AS width
WHERE frame = other
WITH frame, edge, wide, max(CASE WHEN (edge + wide - begin + $columns) % $columns < width THEN 1 ELSE 0 END) AS goes_on
WITH frame, min(goes_on) AS whole
WHERE whole = 1
RETURN frame
ORDER BY frame
