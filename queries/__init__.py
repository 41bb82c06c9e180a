"""The store of a benchmark and its graph, SQL and Cypher queries on them, and the compiler from plans to Cypher."""
