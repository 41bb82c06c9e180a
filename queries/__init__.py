"""Cypher and SQL, the one graph handle, and the store they are asked of."""
