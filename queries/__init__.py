"""The store, queries of it in Cypher and SQL, the graph, and the compiler from plans to Cypher."""
