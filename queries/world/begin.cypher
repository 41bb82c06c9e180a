// Create the node of an episode.
CREATE (:Episode {id: $id, run: $run, question: $question, sequence: $sequence, plan: $plan, verdict: $verdict})
