"""The benchmark: generation of questions, proofs, observation, scoring, runs, reports and the command line."""
