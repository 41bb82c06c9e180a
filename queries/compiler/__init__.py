"""The compiler from graph plan to Cypher, and the solver that runs it.

`clauses` holds the clause templates of conditions and edges, `names` a table of names per namespace that fills them,
`find` puts them together to the statement that finds a plan's people, and `reads` (over beliefs: `beliefs`) asks what
is read of them. `solve` runs all of it for many plans at once.
"""

from __future__ import annotations

from .beliefs import BeliefReader, Rows
from .find import Find, compile_find
from .names import SCENE, WORLD, Names
from .reads import Queried, Who
from .solve import Asked, Outcome, Solution, outcome_of_target, read_with, solve, solve_with

__all__ = [
    "SCENE",
    "WORLD",
    "Asked",
    "BeliefReader",
    "Find",
    "Names",
    "Outcome",
    "Queried",
    "Rows",
    "Solution",
    "Who",
    "compile_find",
    "outcome_of_target",
    "read_with",
    "solve",
    "solve_with",
]
