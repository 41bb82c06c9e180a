// Return the people in a frame who may be in a sector. `v` is the angle of its axis.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.v AS v
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND NOT s.covered
WITH id, n.track AS who, s.angle - v + 180.0 AS turn
WITH id, who, abs(turn - 360.0 * floor(turn / 360.0) - 180.0) AS off WHERE off <= $sector_false
RETURN id, who, off <= $sector_true AS certain ORDER BY id, who
