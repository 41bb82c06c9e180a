"""Sessions on the graph, the only access to the engine for other rooms.

A `Graph` handles these properties of Kùzu for all callers:

- *One database per path and process, and one writing process or many reading ones* (`database.py`).
- *Some statements are answered wrongly without an error* (`wrong_answers.py`). The plan of each distinct statement with
  a pattern is checked once, and such statements are refused.
- *The order of rows differs between runs*. A read must have an ORDER BY, return a single row, or pass `ordered=False`.
- *Parameters get wrong types*: small integers INT8, lists the type of their first items, empty lists none, and a
  missing parameter is NULL. They are bound with 64-bit types here, and their names must be those of the statement.
- *One write transaction at a time*. Writers of one database wait for each other.

Threads that share a `Graph` wait for each other; open several for parallel reads.
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
    create_memory_database,
    engine,
    shorten,
    translate_error,
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
"""Maximum size of the engine's page cache, in bytes. 256 MB sufficed for every query measured on all of JRDB."""

_BUILD_BYTES: Final = 800 << 20
"""Maximum size of the page cache while a graph is built: COPY holds a batch of edges twice, once per direction."""

_ONE_CHUNK: Final = 100_000
"""Maximum number of rows that are fetched as one chunk. The engine allocates ten million cells per chunk by default."""

_PREPARED: Final = 256
"""Maximum number of a session's prepared statements, and of statements with parameters on one connection.

The engine keeps every statement with parameters, half a megabyte or more, until its connection ends."""

_MATCH = re.compile(r"\bMATCH\b", re.IGNORECASE)
_ROW = re.compile(r"\s*CREATE\s*\(", re.IGNORECASE)


class Graph:
    """Session on a graph, made by `Graph.open` or `Graph.memory`; a context manager."""

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
        """Open a graph file.

        Args:
            path: Graph file, made by `build_graph`.
            read_only: Whether the session only reads.
            buffer_bytes: Maximum size of the page cache.
            prepares: Whether statements with parameters are parsed once for many uses, which saves a third of the time
                of small ones.

        Raises:
            StoreError: The file is missing, damaged or of another version.
            LockedError: Another process writes the file, or reads it if this session writes.
        """
        shared = acquire_database(Path(path).resolve(), read_only, buffer_bytes)
        return cls(shared, read_only, prepares)

    @classmethod
    def memory(cls, *, buffer_bytes: int = BUFFER_BYTES, prepares: bool = False) -> Graph:
        """Make an empty graph in memory; the arguments are those of `open`."""
        return cls(create_memory_database(buffer_bytes), prepares=prepares)

    def close(self) -> None:
        """Close the session; the last session of this process closes the file. A second call does nothing."""
        with self._lock:
            if self._closed:
                return
            if self._failed:
                # On a full disk the engine may hang in its checkpoint. Its log has all data.
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
        """Run one reading statement.

        Args:
            cypher: Statement; `$name` is the value of `name` in `params`.
            params: Values of parameters. Pass many rows as one Arrow table: `LOAD FROM $rows WITH ...`.
            ordered: Whether a result of several rows needs an ORDER BY.
            timeout_s: Seconds after which the statement is stopped.

        Raises:
            QueryError: The statement is refused (it would lose rows, writes, or has no order), fails or takes too long.
        """
        text, values = bind(cypher, params or {})
        with self._lock:
            self._check_read(text, values, ordered)
            return self._run(text, values, timeout_s)

    def prepare(self, cypher: str, params: Mapping[str, Any], *, ordered: bool = True) -> None:
        """Check and parse a reading statement before its first use. Raises QueryError if it is refused."""
        text, values = bind(cypher, params)
        with self._lock:
            self._check_read(text, values, ordered)
            self._statement(text, values)

    def _check_read(self, text: str, values: Mapping[str, Any], ordered: bool) -> None:
        plan = self._plan(text, values)
        refuse_wrong_answers(plan, text, lambda probe: self._complaint(probe, values))
        if plan.writes:
            raise QueryError(f"this statement writes, use execute(): {shorten(text)}")
        if ordered and not plan.ordered:
            raise QueryError(f"add an ORDER BY, or pass ordered=False, to: {shorten(text)}")

    def tables(self) -> set[str]:
        """Return the names of the graph's tables."""
        return set(self.query("CALL show_tables() RETURN name AS name", ordered=False)["name"].to_pylist())

    def count_rows(self, timeout_s: float | None = None) -> dict[str, int]:
        """Return the rows of each table. Raises QueryError if the count of a table takes longer than `timeout_s`."""
        counts = {}
        tables = self.query("CALL show_tables() RETURN name, type", ordered=False).to_pylist()
        for name, kind in sorted((table["name"], table["type"]) for table in tables):
            pattern = f"(n:`{name}`)" if kind == "NODE" else f"()-[r:`{name}`]->()"
            rows = self.query(f"MATCH {pattern} RETURN count(*) AS n", timeout_s=timeout_s)
            counts[name] = int(rows["n"][0].as_py())
        return counts

    def explain(self, cypher: str, params: Mapping[str, Any] | None = None) -> QueryPlan:
        """Return the engine's plan of a statement. Raises QueryError if it cannot be planned."""
        text, values = bind(cypher, params or {})
        with self._lock:
            return self._plan(text, values)

    # -- writing ----------------------------------------------------------------------------------------------

    def execute(self, cypher: str, params: Mapping[str, Any] | None = None) -> pa.Table:
        """Run a statement that may write, also inside `transaction()`. Raises QueryError or StoreError if it fails."""
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
        """Append rows to a table of the graph. Edges begin with their two keys; columns have the order of the table."""
        # The engine uses importlib.util without an import of it.
        import importlib.util  # noqa: F401

        # The engine silently loses rows of columns with small chunks.
        self._copy(table, "$rows", {"rows": rows.combine_chunks()})

    def copy_files(self, table: str, folder: Path, names: Sequence[str], ends: Sequence[str] = ()) -> None:
        """Append rows of Parquet files to a table of the graph.

        The engine reads a path as a pattern. So names must be plain, and the process changes to the folder meanwhile.

        Args:
            table: Table of the graph.
            folder: Folder of the files.
            names: Names of the files.
            ends: Node tables at the start and the end of edges, for a table with several pairs.

        Raises:
            QueryError: A name is not plain, or the rows do not fit the table.
        """
        if any(not re.fullmatch(r"[A-Za-z0-9._-]+", name) for name in names):
            raise QueryError("a file to copy from needs a plain name")
        files = ", ".join(f"'{name}'" for name in names)
        with self._writing(), contextlib.chdir(folder):
            pair = f" (from='{ends[0]}', to='{ends[1]}')" if ends else ""
            self._copy(table, f"[{files}]{pair}", {})

    def _copy(self, table: str, source: str, values: Mapping[str, Any]) -> None:
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", table):
            raise QueryError(f"{table!r} is not the name of a table")
        with self._writing():
            self._shared.plans.clear()
            self._run(f"COPY `{table}` FROM {source}", values, None)

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """Run the statements of a `with` block in one write transaction, which an error rolls back."""
        with self._writing():
            self._run("BEGIN TRANSACTION", {}, None)
            self._in_transaction = True
            try:
                yield
            except BaseException:
                # If a statement failed, the engine has already rolled back.
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
        """Return the engine's error message for a statement. An error ends a transaction, so use a new connection."""
        with engine().Connection(self._shared.database) as connection:
            try:
                connection.execute(f"EXPLAIN {text}", dict(values))
            except RuntimeError as error:
                return str(error)
        return ""

    def _renew(self) -> None:
        """Replace a connection that keeps many statements, except inside a transaction."""
        if self._planned >= _PREPARED and not self._in_transaction:
            self._prepared.clear()
            self._connection.close()
            self._connection = engine().Connection(self._shared.database)
            self._planned = 0

    def _statement(self, text: str, values: Mapping[str, Any]) -> Any:
        """Return the prepared statement, or the text.

        A statement with rows as a parameter is not prepared, because the engine would reuse the rows of its first use.
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
                # Close all results, because the engine crashes if only the last result remains.
                for part in result:
                    part.close()
                raise QueryError(f"one statement at a time: {shorten(text)}")
            try:
                # Statements such as CHECKPOINT and BEGIN have no columns.
                if not result.get_column_names():
                    return pa.table({})
                rows = result.get_num_tuples()
                return result.get_as_arrow(max(rows, 1) if rows < _ONE_CHUNK else None)
            finally:
                result.close()
        except RuntimeError as error:
            failure = translate_error(error, text, timeout_s, self.path)
            self._failed |= isinstance(failure, StoreError)
            raise failure from None


@contextlib.contextmanager
def open_worker_graph(path: Path) -> Iterator[Graph]:
    """Yield a session for reading with prepared statements, which a worker process keeps open for its next sequence.

    Opening a graph and planning take longer than most statements. Raises StoreError or LockedError as `Graph.open`.
    """
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


def hold_graph(path: Path, workers: Executor) -> contextlib.AbstractContextManager[object]:
    """Return a context that keeps a graph open if `workers` is 1, so that it is opened once for all sequences.

    With several workers the context is empty, because an open graph takes 150 MB. Raises StoreError or LockedError as
    `Graph.open`.
    """
    return Graph.open(path, read_only=True) if workers == 1 else contextlib.nullcontext()


@contextlib.contextmanager
def build_graph(path: str | Path, *, extend: bool = False) -> Iterator[Graph]:
    """Yield a session on a new graph file, and rename the file to `path` when the block ends.

    If the block raises, the old file stays. The lock of the graph is held meanwhile.

    Args:
        path: Graph file to make or replace.
        extend: Whether the new file begins as a copy of the old one.

    Raises:
        LockedError: A session has the graph open, here or in another process.
        StoreError: The disk refuses.
    """
    target = Path(path).resolve()
    check_unused(target)
    make_parent(target)
    check_room(target)
    with lock_graph(target, shared=False), contextlib.ExitStack() as cleanup:
        temporary = building_path(target)
        # Remove the files of a killed process, which no longer holds the lock.
        remove_files(temporary)
        cleanup.callback(remove_files, temporary)
        if extend:
            copy_files(target, temporary)
        try:
            database = engine().Database(str(temporary), buffer_pool_size=_BUILD_BYTES)
        except RuntimeError as error:
            raise translate_error(error, "", None, target) from None
        with Graph(SharedDatabase(database)) as graph:
            yield graph
            graph.execute("CHECKPOINT")
            rows = graph.count_rows()
        publish(temporary, target, rows)


def remove_graph(path: str | Path) -> None:
    """Remove a graph if it exists. Raises LockedError if a session has it open."""
    target = Path(path).resolve()
    with lock_graph(target, shared=False):
        remove_files(target)
