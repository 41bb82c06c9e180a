// For the read count: relations that an agent believes between its entities.
MATCH (:Episode {id: $scope})-[:Holds]->(n:Entity)-[r:Related]->(m:Entity)
RETURN n.name AS source, r.name AS name, m.name AS target, r.first AS first, r.last AS last,
       CAST(regexp_extract(r.observation, '[0-9]+$') AS INT64) AS look, r.write AS written, r.current AS current
ORDER BY first, source, name, target
