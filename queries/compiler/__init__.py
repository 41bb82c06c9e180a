"""The compiler from graph plan to Cypher, and the solver that runs it.

`clauses` holds the clause templates of conditions and edges, `names` a table of names per namespace that fills them,
`find` puts them together to the statement that finds a plan's people, and `reads` asks what is read of them. `solve`
runs all of it for many plans at once.
"""

from __future__ import annotations

from .find import Find, compile_find
from .names import SCENE, Names
from .solve import Asked, Outcome, Solution, solve

__all__ = ["SCENE", "Asked", "Find", "Names", "Outcome", "Solution", "compile_find", "solve"]
