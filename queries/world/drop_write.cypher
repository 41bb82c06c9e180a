// Takes an episode's rows of Write away, with the edges that end there.
MATCH (e:Episode {id: $episode})-[:Wrote]->(n:Write)
DETACH DELETE n
