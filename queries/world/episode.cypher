// Create the node of an episode.
UNWIND $rows AS r
CREATE (:Episode {id: r.id, run: r.run, question: r.question, sequence: r.sequence})
