"""The store of a benchmark with its graph, queries of both in SQL and Cypher, and the compiler from plans to Cypher."""
