"""The world tables of a graph, for one thread of one process: every statement passes the doors before its first run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

import pyarrow as pa

from jrdb_avr.queries.beliefs.checks import check_reach, check_world
from jrdb_avr.queries.graph.handle import Graph, build_graph
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS, world_ddl

BUFFER_BYTES: Final = 256 << 20
"""Hard limit of the engine's page cache."""

MOST_PASSED: Final = 1_000
"""Texts that are known to have passed the doors; plans of many shapes make many."""

Statement = tuple[str, Mapping[str, Any]]
"""Cypher with its parameters."""


class WorldTables:
    """The world tables of a graph, which are made where they are missing."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self._passed: set[tuple[str, bool]] = set()
        try:
            make_world_tables(graph)
        except BaseException:
            graph.close()
            raise

    @classmethod
    def open(cls, path: Path) -> Self:
        """Those of the graph file at `path`, which is made if there is none. Raises StoreError, LockedError."""
        if not path.exists():
            with build_graph(path) as graph:
                make_world_tables(graph)
        # Of small statements, most of what a second thread does is to wait for work: one takes half the time.
        return cls(Graph.open(path, buffer_bytes=BUFFER_BYTES, threads=1, prepares=True))

    @classmethod
    def memory(cls) -> Self:
        """New ones in memory."""
        return cls(Graph.memory(buffer_bytes=BUFFER_BYTES, prepares=True))

    def close(self) -> None:
        """Give the graph back."""
        self.graph.close()

    def prepare(self, statements: Sequence[Statement], writes: bool) -> None:
        """Let statements through the doors and plan them, for values of these types. Raises QueryError."""
        for cypher, params in statements:
            self._admit(cypher, params, writes=writes)
            self.graph.prepare(cypher, params)

    def query(self, cypher: str, params: Mapping[str, Any], ordered: bool, timeout_s: float | None) -> pa.Table:
        """Run one reading statement. Raises QueryError."""
        self._admit(cypher, params, writes=False)
        return self.graph.query(cypher, params, ordered=ordered, timeout_s=timeout_s)

    def write(self, transactions: Sequence[Sequence[Statement]]) -> None:
        """Run writing statements, each list as one transaction. Raises QueryError, StoreError."""
        for statements in transactions:
            self._write(statements)

    def _write(self, statements: Sequence[Statement]) -> None:
        for cypher, params in statements:
            self._admit(cypher, params, writes=True)
        if len(statements) == 1:
            # It is a transaction by itself, in half the time.
            self.graph.execute(*statements[0])
            return
        with self.graph.transaction():
            for cypher, params in statements:
                self.graph.execute(cypher, params)

    def _admit(self, cypher: str, params: Mapping[str, Any], *, writes: bool) -> None:
        """Let a statement through both doors. Raises QueryError."""
        if (cypher, writes) not in self._passed:
            labels = check_world(cypher, writes=writes)
            check_reach(self.graph.explain(cypher, params), labels)
            if len(self._passed) >= MOST_PASSED:
                self._passed.clear()
            self._passed.add((cypher, writes))


def make_world_tables(graph: Graph) -> None:
    """Make the tables of the world namespace that a graph lacks."""
    there = set(graph.query("CALL show_tables() RETURN name AS name", ordered=False)["name"].to_pylist())
    for name, statement in zip((*WORLD_NODES, *WORLD_RELS), world_ddl(), strict=True):
        if name not in there:
            graph.execute(statement)
