"""The compiler from graph plans to Cypher, and the solver that runs the statements.

`clauses` has the Cypher of each kind of condition and edge, and `mapping` fills in the names of the scene's schema.
`find` joins both to the statement that finds the people of a plan. `reads` reads the answer of a plan. `solve` runs
many plans together.
"""
