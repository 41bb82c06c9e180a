"""The handle on the world namespace: what agents wrote, and nothing else of the graph.

Every statement passes two doors before its first run (world_doors.py), and values come as parameters only. The tables
of a file are kept by a process of their own (world_process.py).

All calls of the engine are made one after the other: many episodes write at once, and with several threads a write
waits for the engine's locks six times as long as it takes. Callers wait for their own call only.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

import pyarrow as pa

from jrdb_avr.queries.beliefs.process import WorldProcess
from jrdb_avr.queries.beliefs.tables import Statement, WorldTables
from jrdb_avr.schema.errors import QueryError

T = TypeVar("T")


class Tables(Protocol):
    """World tables for one thread: in this process, or in one of their own."""

    def prepare(self, statements: Sequence[Statement], writes: bool) -> None:
        """Plan statements for values of these types."""
        ...

    def query(self, cypher: str, params: Mapping[str, Any], ordered: bool, timeout_s: float | None) -> pa.Table:
        """Run one reading statement."""
        ...

    def write(self, transactions: Sequence[Sequence[Statement]]) -> None:
        """Run writing statements, each list as one transaction."""
        ...

    def close(self) -> None:
        """Give the graph back."""
        ...


class WorldGraph:
    """The world tables of a graph. Made by `WorldGraph.open` or `WorldGraph.memory`; a context manager; closed once
    used. May be used from any number of threads.
    """

    def __init__(self, tables: Callable[[], Tables]) -> None:
        self._engine = ThreadPoolExecutor(1, thread_name_prefix="world")
        self._closing = threading.Lock()
        self._closed = False
        try:
            self._tables = self._call(tables)
        except BaseException:
            self._engine.shutdown()
            raise

    @classmethod
    def open(cls, path: str | Path) -> WorldGraph:
        """Open the world tables of the graph file at `path`; what is not there is made, the file or its tables.

        Raises StoreError where the file is no graph or the disk refuses, LockedError naming the holder where another
        process has it open.
        """
        return cls(lambda: WorldProcess(Path(path)))

    @classmethod
    def memory(cls) -> WorldGraph:
        """New world tables in the memory of this process."""
        return cls(WorldTables.memory)

    def close(self) -> None:
        """Give the graph back, after the calls under way. Closing twice is harmless."""
        with self._closing:
            if not self._closed:
                self._closed = True
                self._engine.submit(self._tables.close)
                self._engine.shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # -- statements -----------------------------------------------------------------------------------------------

    def prepare(self, statements: Sequence[Statement], *, writes: bool) -> None:
        """Plan statements that will be run with values of these types, by `write` or by `query`, before what is asked
        after this; nobody waits for it, and what cannot be planned is told when it is run.
        """
        with self._closing:
            if not self._closed:
                self._engine.submit(self._tables.prepare, statements, writes)

    def query(
        self,
        cypher: str,
        params: Mapping[str, Any] | None = None,
        *,
        ordered: bool = True,
        timeout_s: float | None = None,
    ) -> pa.Table:
        """Run one reading statement, as `Graph.query` does. Raises QueryError also where it reaches beyond the world
        tables.
        """
        return self._call(lambda: self._tables.query(cypher, params or {}, ordered, timeout_s))

    def write(self, *transactions: Sequence[Statement]) -> None:
        """Run statements that make, change or delete rows of the world tables, each list as one transaction.

        Raises QueryError where one is refused or fails, StoreError where the disk refuses; nothing of its transaction
        is written then, nor of those after it.
        """
        self._call(lambda: self._tables.write(transactions))

    def _call(self, work: Callable[[], T]) -> T:
        """The result of a piece of work, done by the engine's thread."""
        with self._closing:
            if self._closed:
                raise QueryError("the world model is closed")
            waiting = self._engine.submit(work)
        return waiting.result()
