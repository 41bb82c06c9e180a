"""The two doors that every statement on the world namespace passes before its first run.

Its tables lie beside the scene's in the same database (or in a file of their own), and the engine keeps no tables
apart. So a statement is checked by its words (guard.py; and every label must be a world table's, written plainly) and
by its plan (no table function, no walk of any length, and no scan of a table that the words do not name, so that no
pattern without a label reaches the others).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from typing import Final

from jrdb_avr.queries.graph.guard import check_cypher
from jrdb_avr.queries.graph.parameters import strip_literals
from jrdb_avr.queries.graph.wrong_answers import Plan
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.graph import SCENE_NODES, SCENE_RELS

_LABELS: Final = frozenset(name.lower() for name in (*WORLD_NODES, *WORLD_RELS))
_TABLES: Final = frozenset((*WORLD_NODES, *WORLD_RELS, *SCENE_NODES, *SCENE_RELS))
_TOKEN: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*|[^\s]")
_COLON: Final = ":"
_CLOSING: Final = {"(": ")", "[": "]", "{": "}"}
_ROWS_ALONE: Final = "READ_FTABLE"
"""The table function behind RETURN without MATCH and behind UNWIND of a list: it reads nothing."""

_READS: Final = re.compile("SCAN|EXTEND|PATH|LOOKUP|CALL|COPY|LOAD")
_SCANS: Final = frozenset(
    {
        "SCAN_NODE_TABLE",
        "SCAN_REL_TABLE",
        # Only of a node with one label, which is a world table's then.
        "PRIMARY_KEY_SCAN_NODE_TABLE",
        # Of rows that other operators have made.
        "AGGREGATE_SCAN",
        "ORDER_BY_SCAN",
        "TOP_K_SCAN",
        "UNION_ALL_SCAN",
        "TABLE_FUNCTION_CALL",
    }
)
"""Operators that read, of which a plan tells the tables."""


def check_world(cypher: str, *, writes: bool = False) -> set[str]:
    """Refuse a statement by its words: what `check_cypher` refuses, and every label but the world tables', of which
    those it names are returned in small letters.

    A colon is the mark of a label wherever it does not follow a key in braces, and the names of labels stand plainly:
    no backticks, nothing beyond ASCII. Raises QueryError.
    """
    check_cypher(cypher, writes=writes)
    bare = strip_literals(cypher)
    if "`" in cypher or not bare.isascii():
        raise QueryError("names in backticks and letters beyond ASCII are not allowed here: pass texts as parameters")
    tokens = [found[0] for found in _TOKEN.finditer(bare)]
    open_brackets = [""]
    named: set[str] = set()
    for at, token in enumerate(tokens):
        if token in _CLOSING:
            open_brackets.append(token)
        elif token in _CLOSING.values() and len(open_brackets) > 1:
            open_brackets.pop()
        elif token == _COLON and not (open_brackets[-1] == "{" and at > 1 and tokens[at - 2] in ("{", ",")):
            for label in _labels(tokens, at + 1):
                if label.lower() not in _LABELS:
                    raise QueryError(f"{label!r} is no table of the world model: {', '.join(sorted(_LABELS))}")
                named.add(label.lower())
    return named


def _labels(tokens: Sequence[str], at: int) -> Iterator[str]:
    """The label after a colon, and its alternatives: what follows each `|`, with or without a colon."""
    yield tokens[at] if at < len(tokens) else ""
    while tokens[at + 1 : at + 2] == ["|"]:
        at += 3 if tokens[at + 2 : at + 3] == [_COLON] else 2
        yield tokens[at] if at < len(tokens) else ""


def check_reach(plan: Plan, labels: Collection[str] = ()) -> None:
    """Refuse a statement by its plan: it calls a table function, walks edges any number of times (such a plan does not
    say over which tables), or scans what is not one world table, nor several that it names itself (`labels`, in small
    letters).

    A plan lists the tables of a scan in boxes of their own, one after the other. Raises QueryError.
    """
    if set(plan.functions) - {_ROWS_ALONE}:
        raise QueryError("this reads something else than the graph")
    if unknown := sorted({name for name in plan.operators if _READS.search(name)} - _SCANS):
        raise QueryError(f"{unknown[0]} does not say which tables it reads: write the pattern edge by edge")
    cells = {cell.strip() for cell in plan.text.split("│")}
    scanned = {cell.removeprefix("Tables: ") for cell in cells if cell.startswith("Tables: ")}
    several = {name for name in cells & _TABLES if name.lower() not in labels}
    if foreign := sorted(scanned - {*WORLD_NODES, *WORLD_RELS} | several):
        raise QueryError(f"this reaches {foreign[0]}: every node and edge of a pattern needs the label of one table")
