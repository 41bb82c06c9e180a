"""JRDB-AVR: active visual reasoning over JRDB, as a benchmark with proofs.

The packages, from the bottom up (each may import only those above it, `agent` only the first and third):

schema   what is stored and said
loaders  JRDB files to annotation tables, intervals and the scene graph; the sample world
queries  Cypher, SQL and the one graph handle
engine   generation, proofs, observation, scoring, runs, reports and the command line
agent    methods that take the benchmark
"""

__version__ = "0.1.0"
