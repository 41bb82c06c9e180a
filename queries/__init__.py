"""The store of a benchmark, its graph, queries of both in SQL and Cypher, and the compiler from plans to Cypher."""
