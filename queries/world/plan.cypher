// The plan of an episode.
MATCH (e:Episode {id: $id})
SET e.plan = $plan
