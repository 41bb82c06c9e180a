"""The handle on the world namespace: what agents wrote, and nothing else of the graph.

The world tables lie beside the scene's in the same database (or in a file of their own), and the engine keeps no tables
apart. So every statement passes two checks before its first run: of its words (guard.py; and every label must be a
world table's, written plainly) and of its plan (no table function, no walk of any length, and no scan of a table that
the words do not name, so that no pattern without a label reaches the others). Values come as parameters only.
"""

from __future__ import annotations

import contextlib
import re
import threading
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

import pyarrow as pa

from jrdb_avr.queries.graph.guard import check_cypher
from jrdb_avr.queries.graph.handle import Graph, build_graph
from jrdb_avr.queries.graph.parameters import strip_literals
from jrdb_avr.queries.graph.wrong_answers import QueryPlan
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, SCENE_NODES, SCENE_RELS, table_ddl

MOST_CHECKED: Final = 1_000
"""Texts that are known to have passed the checks; plans of many shapes make many."""

Statement = tuple[str, Mapping[str, Any]]
"""Cypher with its parameters."""


class WorldGraph:
    """The world tables of a graph. Made by `WorldGraph.open` or `WorldGraph.memory`; a context manager; closed once
    used. May be used from any number of threads, which take turns. counts: statements that read and that wrote.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.counts: Counter[str] = Counter(reads=0, writes=0)
        self._counting = threading.Lock()
        self._checked: set[tuple[str, bool]] = set()

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open the world tables of the graph file at `path`; what is missing is made, the file or its tables.

        Raises StoreError where the file is no graph or the disk refuses, LockedError naming the holder where another
        process has it open.
        """
        return cls(open_graph(path, prepares=True))

    @classmethod
    def memory(cls) -> Self:
        """New world tables in memory."""
        return cls(make_world_tables(Graph.memory(prepares=True)))

    def close(self) -> None:
        """Give the graph back, after the calls under way. Closing twice is harmless."""
        self.graph.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def query(self, cypher: str, params: Mapping[str, Any] | None = None, **options: Any) -> pa.Table:
        """Run one reading statement, as `Graph.query` does, with its options. Raises QueryError also where it reaches
        beyond the world tables.
        """
        self._check(cypher, params or {}, writes=False)
        self._count("reads", 1)
        return self.graph.query(cypher, params, **options)

    def prepare(self, cypher: str, params: Mapping[str, Any], **options: Any) -> None:
        """Check and parse one reading statement before its first use, as `Graph.prepare` does. Raises QueryError as
        `query` does.
        """
        self._check(cypher, params, writes=False)
        self.graph.prepare(cypher, params, **options)

    def write(self, statements: Sequence[Statement]) -> None:
        """Run statements that make, change or delete rows of the world tables, as one transaction.

        Raises QueryError where one is refused or fails, StoreError where the disk refuses; nothing is written then.
        """
        for cypher, params in statements:
            self._check(cypher, params, writes=True)
        # A single statement is a transaction by itself, in half the time.
        with self.graph.transaction() if len(statements) > 1 else contextlib.nullcontext():
            for cypher, params in statements:
                self.graph.execute(cypher, params)
        self._count("writes", len(statements))

    def _count(self, kind: str, statements: int) -> None:
        with self._counting:
            self.counts[kind] += statements

    def _check(self, cypher: str, params: Mapping[str, Any], *, writes: bool) -> None:
        """Let a statement through both checks. Raises QueryError."""
        if (cypher, writes) not in self._checked:
            labels = check_world(cypher, writes=writes)
            check_reach(self.graph.explain(cypher, params), labels)
            if len(self._checked) >= MOST_CHECKED:
                self._checked.clear()
            self._checked.add((cypher, writes))


def open_graph(path: str | Path, **options: Any) -> Graph:
    """The graph file at `path` with the tables of the world namespace, for writing; made if there is none.

    options: those of `Graph.open`. Raises LockedError where another process has it open, StoreError where it cannot be
    opened.
    """
    if not Path(path).exists():
        with build_graph(path) as graph:
            make_world_tables(graph)
    return make_world_tables(Graph.open(path, **options))


def make_world_tables(graph: Graph) -> Graph:
    """Make the tables of the world namespace that a graph lacks; the graph, which is closed where that fails."""
    try:
        there = graph.tables()
        tables = zip((*WORLD_NODES, *WORLD_RELS), table_ddl(WORLD_NODES, WORLD_RELS), strict=True)
        if missing := [statement for name, statement in tables if name not in there]:
            # In one transaction they are written to disk together.
            with graph.transaction():
                for statement in missing:
                    graph.execute(statement)
    except BaseException:
        graph.close()
        raise
    return graph


# -- what statements may reach ----------------------------------------------------------------------------------------

_LABELS: Final = frozenset(name.lower() for name in (*WORLD_NODES, *WORLD_RELS))
_TABLES: Final = frozenset((*WORLD_NODES, *WORLD_RELS, *SCENE_NODES, *SCENE_RELS, *LAYER_NODES, *LAYER_RELS))
_TOKEN: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*|[^\s]")
_COLON: Final = ":"
_CLOSING: Final = {"(": ")", "[": "]", "{": "}"}
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


def check_reach(plan: QueryPlan, labels: Collection[str] = ()) -> None:
    """Refuse a statement by its plan: it calls a table function, walks edges any number of times (such a plan does not
    say over which tables), or scans what is not one world table, nor several that it names itself (`labels`, in small
    letters).

    A plan lists the tables of a scan in boxes of their own, one after the other. Raises QueryError.
    """
    if plan.functions:
        raise QueryError("this reads something else than the graph")
    if unknown := sorted({name for name in plan.operators if _READS.search(name)} - _SCANS):
        raise QueryError(f"{unknown[0]} does not say which tables it reads: write the pattern edge by edge")
    cells = {cell.strip() for cell in plan.text.split("│")}
    scanned = {cell.removeprefix("Tables: ") for cell in cells if cell.startswith("Tables: ")}
    several = {name for name in cells & _TABLES if name.lower() not in labels}
    if foreign := sorted(scanned - {*WORLD_NODES, *WORLD_RELS} | several):
        raise QueryError(f"this reaches {foreign[0]}: every node and edge of a pattern needs the label of one table")
