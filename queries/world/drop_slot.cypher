// Takes an episode's rows of Slot away, with the edges that end there.
MATCH (e:Episode {id: $episode})-[:Asks]->(n:Slot)
DETACH DELETE n
