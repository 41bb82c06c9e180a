"""The one handle on the graph: plan guard, COPY, bound parameters, Arrow out.

Kùzu needs care that every caller would otherwise have to remember:

- *One database per path per process, one writing process or many reading ones* (`database.py`).
- *Some statements are answered wrongly without an error* (`wrong_answers.py`): every distinct statement that matches a
  pattern is explained once, and refused if it is one of them.
- *Row order differs between runs*: a read must be ordered, or return a single row, or pass `ordered=False`.
- *Small integers are bound as INT8*, a list by its first rows, an empty list not at all, and a missing parameter is
  NULL: parameters are bound here under 64-bit types, and their names must be the statement's.
- *One write transaction at a time*: writers of one database wait for each other.

A `Graph` may be used from several threads, which then wait for each other; open another one for reads side by side.
"""

from __future__ import annotations

import contextlib
import re
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

import pyarrow as pa

from jrdb_avr.queries import workers as processes
from jrdb_avr.queries.graph.database import (
    SharedDatabase,
    acquire_database,
    check_unused,
    engine,
    memory_database,
    shortened,
    translated,
)
from jrdb_avr.queries.graph.file import (
    building_path,
    check_room,
    copy_files,
    lock_graph,
    make_parent,
    publish,
    remove_files,
)
from jrdb_avr.queries.graph.parameters import bind, strip_literals
from jrdb_avr.queries.graph.wrong_answers import QueryPlan, refuse_wrong_answers
from jrdb_avr.queries.workers import Executor
from jrdb_avr.schema.errors import QueryError, StoreError

BUFFER_BYTES: Final = 512 << 20
"""Hard limit of the engine's page cache; 256 MB held every query measured at full size."""

_BUILD_BYTES: Final = 800 << 20
"""The same while a graph is built: COPY holds every row of a batch, in both directions of an edge."""

_ONE_CHUNK: Final = 100_000
"""Rows up to which a result is one chunk of its own size; the engine's own are of ten million cells, full or not."""

_PREPARED: Final = 256
"""Statements that a graph keeps prepared at a time: parsed, that is; the engine plans them at each use. Also plannings
before a connection is given up for a new one: the engine holds every statement with parameters, half a megabyte
each and more, until its connection ends."""

_MATCH = re.compile(r"\bMATCH\b", re.IGNORECASE)
_ROW = re.compile(r"\s*CREATE\s*\(", re.IGNORECASE)


class Graph:
    """A session on a graph, made by `Graph.open` or `Graph.memory`; a context manager, closed after use."""

    def __init__(self, shared: SharedDatabase, read_only: bool = False, prepares: bool = False) -> None:
        self.path = shared.path
        self.read_only = read_only
        self._shared = shared
        self._lock = threading.RLock()
        self._connection = engine().Connection(shared.database)
        self._prepares = prepares
        self._prepared: dict[str, Any] = {}
        self._planned = 0
        self._in_transaction = False
        self._failed = False
        self._closed = False

    # -- opening ----------------------------------------------------------------------------------------------

    @classmethod
    def open(
        cls, path: str | Path, *, read_only: bool = False, buffer_bytes: int = BUFFER_BYTES, prepares: bool = False
    ) -> Graph:
        """Open the graph file at `path`, made by `build_graph`.

        prepares: statements with parameters are parsed once for many uses, which takes a third off the
        time of small ones.
        Raises StoreError where there is none, or one that is cut short or of another version, and LockedError naming
        the holder where another process writes it (or, for writing, reads it).
        """
        shared = acquire_database(Path(path).resolve(), read_only, buffer_bytes)
        return cls(shared, read_only, prepares)

    @classmethod
    def memory(cls, *, buffer_bytes: int = BUFFER_BYTES, prepares: bool = False) -> Graph:
        """A new empty graph in memory, for a worker's own sequence; prepares: as of `open`."""
        return cls(memory_database(buffer_bytes), prepares=prepares)

    def close(self) -> None:
        """Close the graph; its last user in this process closes the file. Closing twice is harmless."""
        with self._lock:
            if self._closed:
                return
            if self._failed:
                # A full disk: the engine may never come back from trying the checkpoint, and its log holds all.
                with contextlib.suppress(RuntimeError):
                    self._connection.execute("CALL force_checkpoint_on_close=false")
            self._closed = True
            self._prepared.clear()
            self._connection.close()
            self._shared.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # -- reading ----------------------------------------------------------------------------------------------

    def query(
        self,
        cypher: str,
        params: Mapping[str, Any] | None = None,
        *,
        ordered: bool = True,
        timeout_s: float | None = None,
    ) -> pa.Table:
        """Run one reading statement; `$name` in it are bound to `params`.

        Many rows of input are best passed as one Arrow table: `LOAD FROM $rows WITH ...`. A result of several rows
        needs an ORDER BY, unless `ordered=False` allows any order. Raises QueryError where the
        statement is refused (its plan would lose rows, it writes, its order is open), fails, or takes too long.
        """
        text, values = bind(cypher, params or {})
        with self._lock:
            self._check_read(text, values, ordered)
            return self._run(text, values, timeout_s)

    def prepare(self, cypher: str, params: Mapping[str, Any], *, ordered: bool = True) -> None:
        """Check and parse a reading statement before its first use, which then takes as long as any other.

        Raises QueryError where it is refused.
        """
        text, values = bind(cypher, params)
        with self._lock:
            self._check_read(text, values, ordered)
            self._statement(text, values)

    def _check_read(self, text: str, values: Mapping[str, Any], ordered: bool) -> None:
        plan = self._plan(text, values)
        refuse_wrong_answers(plan, text, lambda probe: self._complaint(probe, values))
        if plan.writes:
            raise QueryError(f"this statement writes, use execute(): {shortened(text)}")
        if ordered and not plan.ordered:
            raise QueryError(f"add an ORDER BY, or pass ordered=False, to: {shortened(text)}")

    def tables(self) -> set[str]:
        """The names of the graph's tables."""
        return set(self.query("CALL show_tables() RETURN name AS name", ordered=False)["name"].to_pylist())

    def explain(self, cypher: str, params: Mapping[str, Any] | None = None) -> QueryPlan:
        """The engine's plan of a statement. Raises QueryError where it cannot be planned."""
        text, values = bind(cypher, params or {})
        with self._lock:
            return self._plan(text, values)

    # -- writing ----------------------------------------------------------------------------------------------

    def execute(self, cypher: str, params: Mapping[str, Any] | None = None) -> pa.Table:
        """Run one statement that may write, alone or inside `transaction()`. Raises QueryError, StoreError."""
        text, values = bind(cypher, params or {})
        with self._writing():
            bare = strip_literals(text)
            if _MATCH.search(bare):
                refuse_wrong_answers(self._plan(text, values), text, lambda probe: self._complaint(probe, values))
            elif not _ROW.match(bare):
                # A change of tables may change every plan.
                self._shared.plans.clear()
            return self._run(text, values, None)

    def copy(self, table: str, rows: pa.Table) -> None:
        """Append rows to a table of the graph; columns in the table's order, for edges the two keys first."""
        # The engine looks for pandas by importlib.util, and fails where nobody has imported it yet.
        import importlib.util  # noqa: F401

        # Of a column in chunks the engine reads the rows of small ones only in part, silently.
        self._copy(table, "$rows", {"rows": rows.combine_chunks()})

    def copy_files(self, table: str, folder: Path, names: Sequence[str], ends: Sequence[str] = ()) -> None:
        """As `copy`, from Parquet files of a folder. `ends`: the tables of nodes that edges start and end at.

        The engine reads a path as a pattern, so the names must be plain and the process changes to the folder
        meanwhile, whose own name is then no matter.
        """
        if any(not re.fullmatch(r"[A-Za-z0-9._-]+", name) for name in names):
            raise QueryError("a file to copy from needs a plain name")
        files = ", ".join(f"'{name}'" for name in names)
        with self._writing(), contextlib.chdir(folder):
            pair = f" (from='{ends[0]}', to='{ends[1]}')" if ends else ""
            self._copy(table, f"[{files}]{pair}", {})

    def _copy(self, table: str, source: str, values: Mapping[str, Any]) -> None:
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", table):
            raise QueryError(f"{table!r} is no name of a table")
        with self._writing():
            self._shared.plans.clear()
            self._run(f"COPY `{table}` FROM {source}", values, None)

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """One write transaction round the statements inside; an error rolls all of them back."""
        with self._writing():
            self._run("BEGIN TRANSACTION", {}, None)
            self._in_transaction = True
            try:
                yield
            except BaseException:
                # The engine has already rolled back if one of its own statements failed.
                with contextlib.suppress(QueryError, StoreError):
                    self._run("ROLLBACK", {}, None)
                raise
            else:
                self._run("COMMIT", {}, None)
            finally:
                self._in_transaction = False

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        if self.read_only:
            raise QueryError("the graph is open for reading only")
        with self._shared.writer, self._lock:
            yield

    # -- the engine -------------------------------------------------------------------------------------------

    def _plan(self, text: str, values: Mapping[str, Any]) -> QueryPlan:
        plan: QueryPlan | None = self._shared.plans.get(text)
        if plan is None:
            plan = QueryPlan(str(self._run(f"EXPLAIN {text}", values, None).column(0)[0].as_py()))
            if len(self._shared.plans) >= _PREPARED:
                self._shared.plans.clear()
            self._shared.plans[text] = plan
        return plan

    def _complaint(self, text: str, values: Mapping[str, Any]) -> str:
        """What the engine says against a statement; on a connection of its own, as an error ends a transaction."""
        with engine().Connection(self._shared.database) as connection:
            try:
                connection.execute(f"EXPLAIN {text}", dict(values))
            except RuntimeError as error:
                return str(error)
        return ""

    def _renew(self) -> None:
        """Replace a connection that holds many planned statements; not within a transaction, which belongs to it."""
        if self._planned >= _PREPARED and not self._in_transaction:
            self._prepared.clear()
            self._connection.close()
            self._connection = engine().Connection(self._shared.database)
            self._planned = 0

    def _statement(self, text: str, values: Mapping[str, Any]) -> Any:
        """The statement for the engine: prepared, or as text. With rows as a parameter it is never prepared, as the
        engine would use those of the first time again.
        """
        rows = any(isinstance(value, pa.Table) for value in values.values())
        if not (self._prepares and values) or rows or text.startswith("EXPLAIN"):
            self._planned += bool(values)
            return text
        prepared = self._prepared.get(text)
        if prepared is None:
            prepared = engine().PreparedStatement(self._connection, text, dict(values))
            self._planned += 1
            if len(self._prepared) >= _PREPARED:
                self._prepared.clear()
            self._prepared[text] = prepared
        return prepared

    def _run(self, text: str, values: Mapping[str, Any], timeout_s: float | None) -> pa.Table:
        if self._closed:
            raise QueryError("the graph is closed")
        try:
            self._renew()
            self._connection.set_query_timeout(0 if timeout_s is None else max(1, round(timeout_s * 1000)))
            result = self._connection.execute(self._statement(text, values), dict(values))
            if isinstance(result, list):
                # The rest must go first: the engine crashes when only the last result stays.
                for part in result:
                    part.close()
                raise QueryError(f"one statement at a time: {shortened(text)}")
            try:
                # Statements of control (CHECKPOINT, BEGIN) have no columns at all.
                if not result.get_column_names():
                    return pa.table({})
                rows = result.get_num_tuples()
                return result.get_as_arrow(max(rows, 1) if rows < _ONE_CHUNK else None)
            finally:
                result.close()
        except RuntimeError as error:
            failure = translated(error, text, timeout_s, self.path)
            self._failed |= isinstance(failure, StoreError)
            raise failure from None


@contextlib.contextmanager
def worker_graph(path: Path) -> Iterator[Graph]:
    """A session for reading, which a worker process leaves open for its next item: opening and planning take longer
    than most statements, which are parsed once for all items. Raises as `Graph.open`."""
    with contextlib.ExitStack() as closing:
        graph = _left_open.get(path)
        if graph is None:
            graph = Graph.open(path, read_only=True, prepares=True)
            if processes.is_worker:
                _left_open[path] = graph
            else:
                closing.enter_context(graph)
        yield graph


_left_open: dict[Path, Graph] = {}


def held_graph(path: Path, workers: Executor) -> contextlib.AbstractContextManager[object]:
    """A graph held open while this process works on all sequences itself, so that it is opened and a statement planned
    once; nothing while others do, as to open it takes 150 MB. Raises as `Graph.open`."""
    return Graph.open(path, read_only=True) if workers == 1 else contextlib.nullcontext()


@contextlib.contextmanager
def build_graph(path: str | Path, *, extend: bool = False) -> Iterator[Graph]:
    """Build a graph beside `path` and rename it in when the block ends well; otherwise the old one stays.

    extend: whether it begins as a copy of the old one. Holds the graph's lock throughout. Raises LockedError where
    anybody has the graph open, StoreError where the disk refuses.
    """
    place = Path(path).resolve()
    check_unused(place)
    make_parent(place)
    check_room(place)
    with lock_graph(place, shared=False), contextlib.ExitStack() as cleanup:
        temporary = building_path(place)
        # What a killed builder left behind; the lock proves that it is gone.
        remove_files(temporary)
        cleanup.callback(remove_files, temporary)
        if extend:
            copy_files(place, temporary)
        try:
            database = engine().Database(str(temporary), buffer_pool_size=_BUILD_BYTES)
        except RuntimeError as error:
            raise translated(error, "", None, place) from None
        with Graph(SharedDatabase(database)) as graph:
            yield graph
            graph.execute("CHECKPOINT")
        publish(temporary, place)


def remove_graph(path: str | Path) -> None:
    """Remove a graph, if there is one. Raises LockedError where it is open anywhere, StoreError as `lock_graph`."""
    place = Path(path).resolve()
    with lock_graph(place, shared=False):
        remove_files(place)
