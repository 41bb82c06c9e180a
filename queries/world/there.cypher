// Is there an episode of this key?
MATCH (e:Episode {id: $episode})
RETURN count(*) AS episodes
