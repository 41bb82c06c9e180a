"""The compiler from graph plan to Cypher, and the solver that runs it.

`clauses` holds the clause templates of conditions and edges, `names` a table of names that fills them, `find` puts them
together to the statement that finds a plan's people, and `reads` asks what is read of them; over beliefs these two are
`believed_find` and `beliefs`. `solve` runs all of it for many plans at once.
"""

from __future__ import annotations

from jrdb_avr.queries.compiler.beliefs import BeliefReader, Rows
from jrdb_avr.queries.compiler.believed_find import find_believed
from jrdb_avr.queries.compiler.find import Find, compile_find
from jrdb_avr.queries.compiler.mapping import SCENE, Names
from jrdb_avr.queries.compiler.outcome import Outcome, Who, outcome_of_target
from jrdb_avr.queries.compiler.reads import Queried
from jrdb_avr.queries.compiler.solve import Asked, Solution, read_with, solve, solve_with

__all__ = [
    "SCENE",
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
    "find_believed",
    "outcome_of_target",
    "read_with",
    "solve",
    "solve_with",
]
