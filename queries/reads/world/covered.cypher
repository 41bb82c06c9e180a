// presence, leaves, returns: frames of which the whole panorama is observed. Where a crop ends, another one must go on,
// where that is so for all crops of a frame, no column is left out.
MATCH (:Episode {id: $scope})-[:Made]->(o:Observation)
WITH collect({frame: o.frame, onset: o.left, width: o.width}) AS looks
UNWIND looks AS l
UNWIND looks AS k
WITH l.frame AS frame, l.onset AS edge, l.width AS wide, k.frame AS other, k.onset AS onset, k.width AS width
WHERE frame = other
WITH frame, edge, wide, max(CASE WHEN (edge + wide - onset + $columns) % $columns < width THEN 1 ELSE 0 END) AS goes_on
WITH frame, min(goes_on) AS whole
WHERE whole = 1
RETURN frame
ORDER BY frame
