// Takes an episode's rows of Entity away, with the edges that end there.
MATCH (e:Episode {id: $episode})-[:Holds]->(n:Entity)
DETACH DELETE n
