"""The compiler from graph plan to Cypher, and the solver that runs it.

`clauses` holds the Cypher of each kind of condition and edge, `mapping` fills it with the names of the scene's schema,
`find` joins both into the statement that finds a plan's people, and `reads` queries what the plan reads of them.
`beliefs` is the counterpart of `find` and `reads` over an agent's beliefs. `solve` runs all of it for many plans at
once.
"""
