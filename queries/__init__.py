"""The store and the graph of a benchmark, queries in SQL and Cypher, and the compiler from plans to Cypher."""
