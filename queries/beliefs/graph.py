"""Graph with the tables of the world models, which agents read and append to by fixed statements.

While a run is made, its world models are in a graph file of their own. So other programs can query the store's graph.
At the end of the run, the rows are merged into the store's graph (`record.py`).
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from jrdb_avr.queries.graph.handle import Graph, build_graph
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.graph import table_ddl

Statement = tuple[str, Mapping[str, Any]]
"""Cypher with its parameters."""


class WorldGraph(contextlib.AbstractContextManager["WorldGraph"]):
    """Session on the world tables. Any number of threads may use it; they take turns.

    Attributes:
        graph: The session.
        counts: Number of statements that read and that wrote, by "reads" and "writes". Number of turns, by "turns".
        seconds: Processor seconds of each batch of statements, in the order of the batches.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.counts: Counter[str] = Counter(turns=0, reads=0, writes=0)
        self.seconds: list[float] = []
        self._lock = threading.Lock()

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open the graph file at `path`, and make it if it is missing.

        Raises:
            StoreError: If the file is not a graph, or the disk is full.
            LockedError: If another process has the file open.
        """
        return cls(open_graph(path, prepares=True))

    @classmethod
    def memory(cls) -> Self:
        """Make world tables in memory."""
        return cls(make_world_tables(Graph.memory(prepares=True)))

    def close(self) -> None:
        """Close the session. A second call does nothing."""
        self.graph.close()

    def __exit__(self, *error: object) -> None:
        self.close()

    def begin_turn(self) -> None:
        """Count a turn, so that the statements of a run can be compared with its turns."""
        with self._lock:
            self.counts["turns"] += 1

    def read(self, cypher: str, params: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return the rows of a reading statement.

        Raises:
            QueryError: If the statement fails.
        """
        with self._measured("reads", 1):
            rows: list[dict[str, Any]] = self.graph.query(cypher, params).to_pylist()
            return rows

    def write(self, statements: Sequence[Statement]) -> None:
        """Run statements that add rows, as one transaction.

        Raises:
            QueryError: If a statement fails. Then nothing is written.
            StoreError: If the disk is full. Then nothing is written.
        """
        # A single statement is a transaction by itself, in half the time.
        together = self.graph.transaction() if len(statements) > 1 else contextlib.nullcontext()
        with self._measured("writes", len(statements)), together:
            for cypher, params in statements:
                self.graph.execute(cypher, params)

    @contextlib.contextmanager
    def _measured(self, kind: str, statements: int) -> Iterator[None]:
        started = time.thread_time()
        yield
        with self._lock:
            self.counts[kind] += statements
            self.seconds.append(time.thread_time() - started)


def open_graph(path: str | Path, **options: Any) -> Graph:
    """Open a graph file with the world tables for writing, and make it if it is missing.

    Args:
        path: The file.
        **options: Options of `Graph.open`.

    Returns:
        The session.

    Raises:
        LockedError: If another process has the file open.
        StoreError: If the file cannot be opened.
    """
    if not Path(path).exists():
        with build_graph(path) as graph:
            make_world_tables(graph)
    return make_world_tables(Graph.open(path, **options))


def make_world_tables(graph: Graph) -> Graph:
    """Make the world tables that a graph lacks. Close the graph if that fails.

    Args:
        graph: The session.

    Returns:
        The session.
    """
    try:
        present = graph.tables()
        tables = zip((*WORLD_NODES, *WORLD_RELS), table_ddl(WORLD_NODES, WORLD_RELS), strict=True)
        if missing := [statement for name, statement in tables if name not in present]:
            # In one transaction they are written to disk together.
            with graph.transaction():
                for statement in missing:
                    graph.execute(statement)
    except BaseException:
        graph.close()
        raise
    return graph
