// Set the plan of an episode, and the verdict on its answer.
MATCH (e:Episode {id: $id})
SET e.plan = $plan, e.verdict = $verdict
