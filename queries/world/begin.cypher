// Create an episode.
CREATE (:Episode {id: $id, run: $run, question: $question, sequence: $sequence, plan: $plan, verdict: $verdict})
