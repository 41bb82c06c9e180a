// Return the people who may be within `v` degrees at a side of a person, as the robot sees them. `side` is 1 for left.
UNWIND $asked AS q WITH q.id AS id, q.at AS at, q.v AS v, q.side AS side, q.person AS person
MATCH (n:Person)-[s:SeenIn]->(f:Frame) WHERE n.sequence IN $scopes AND f.id = at AND n.id = person
WITH id, v, side, n, s, f MATCH (m:Person)-[z:SeenIn]->(f) WHERE m.sequence IN $scopes AND m.id <> n.id
  AND NOT z.covered WITH id, v, m.track AS who, side * (s.angle - z.angle) AS turn
WITH id, v, who, turn - 360.0 * floor(turn / 360.0) AS turn
WHERE turn <= $margin OR 360.0 - turn <= $margin OR turn - v <= $margin
RETURN id, who, turn > $margin AND 360.0 - turn > $margin AND v - turn > $margin AS certain ORDER BY id, who
