// Takes an episode away, once what it holds has gone.
MATCH (e:Episode {id: $episode})
DETACH DELETE e
