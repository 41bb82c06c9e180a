// Takes an episode's rows of Observation away, with the edges that end there.
MATCH (e:Episode {id: $episode})-[:Made]->(n:Observation)
DETACH DELETE n
