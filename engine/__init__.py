"""The benchmark: generation, proofs, observation, scoring, runs, reports, the command line."""
