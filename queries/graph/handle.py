"""Sessions on the graph. Code outside `queries/graph` uses the engine only through a session.

The class `Graph` is a session. It handles these properties of the engine Kùzu for its callers:

- *A process can open a graph file only once. Either one process writes the file, or several processes read the file*.
  Sessions share one database per file (`database.py`).
- *The engine answers some statements wrongly without an error* (`wrong_answers.py`). The session checks each distinct
  statement once, and refuses a statement that would be answered wrongly.
- *The order of rows differs between runs*. A statement that reads must have an ORDER BY or return a single row. Callers
  that accept any order pass `ordered=False`.
- *Parameters get wrong types*. A small integer becomes INT8, a list takes the type of its first item, an empty list has
  no type, and a missing parameter becomes NULL. The session binds 64-bit types, and refuses missing and unknown
  parameters.
- *Only one write transaction can be open*. Sessions that write to one database wait for each other.

Threads that share a `Graph` wait for each other. To read in parallel, open one session per thread.
"""

from __future__ import annotations

import contextlib
import re
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

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

_BUILD_BYTES: Final = 800 << 20
"""Maximum size of the page cache during a build, in bytes. COPY holds each batch of edges in memory twice."""

_ONE_CHUNK: Final = 100_000
"""Results with fewer rows are fetched as one chunk of exactly that many rows.

If no chunk size is given, the engine allocates memory for ten million cells, even for a small result.
"""

_PREPARED: Final = 256
"""Number of statements with parameters after which a session replaces its connection.

Until the connection ends, the engine keeps half a megabyte or more for each such statement.
"""

_MATCH = re.compile(r"\bMATCH\b", re.IGNORECASE)
_ROW = re.compile(r"\s*CREATE\s*\(", re.IGNORECASE)


class Graph(contextlib.AbstractContextManager["Graph"]):
    """Session on a graph file (`Graph.open`) or on a new graph in memory (`Graph.memory`). Use it in a `with` block."""

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
    def open(cls, path: str | Path, *, read_only: bool = False, prepares: bool = False) -> Graph:
        """Open a session on a graph file.

        Args:
            path: Graph file that `build_graph` made.
            read_only: Whether the session only reads.
            prepares: Whether the session keeps each parsed statement with parameters, and reuses it for later calls.
                This saves a third of the time of small statements.

        Raises:
            StoreError: If the file is missing or damaged, or has another version.
            LockedError: If another process writes the file, or if another process reads it and this session writes.
        """
        return cls(acquire_database(Path(path).resolve(), read_only), read_only, prepares)

    @classmethod
    def memory(cls, *, prepares: bool = False) -> Graph:
        """Open a session on a new, empty graph in memory. The method `open` describes the arguments."""
        return cls(create_memory_database(), prepares=prepares)

    def close(self) -> None:
        """Close the session. The last session that uses the file closes the file too. A second call has no effect."""
        with self._lock:
            if self._closed:
                return
            if self._failed:
                # A write failed, maybe because the disk is full. Skip the checkpoint, because it could then hang. No
                # data is lost, because the log of the engine has all changes.
                with contextlib.suppress(RuntimeError):
                    self._connection.execute("CALL force_checkpoint_on_close=false")
            self._closed = True
            self._prepared.clear()
            self._connection.close()
            self._shared.release()

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
        """Run one statement that only reads.

        Args:
            cypher: Statement. `$name` stands for the value of the parameter `name`.
            params: Values of the parameters, by name. An Arrow table can be read by `LOAD FROM $rows WITH ...`.
            ordered: Whether to refuse the statement if it returns several rows without an ORDER BY.
            timeout_s: Maximum time in seconds, after which the statement is stopped, or None for no limit.

        Returns:
            The rows that the statement returns.

        Raises:
            QueryError: If the statement is refused, fails, or takes longer than `timeout_s`. A statement is refused if
                it writes, lacks an order, or would be answered wrongly by the engine.
        """
        text, values = bind(cypher, params or {})
        with self._lock:
            plan = self._plan(text, values)
            refuse_wrong_answers(plan, text, lambda probe: self._complaint(probe, values))
            if plan.writes:
                raise QueryError(f"this statement writes, use execute(): {shorten(text)}")
            if ordered and not plan.ordered:
                raise QueryError(f"add an ORDER BY, or pass ordered=False, to: {shorten(text)}")
            return self._run(text, values, timeout_s)

    def tables(self) -> set[str]:
        """Return the names of all tables of the graph."""
        return set(self.query("CALL show_tables() RETURN name AS name", ordered=False)["name"].to_pylist())

    def count_rows(self, timeout_s: float | None = None) -> dict[str, int]:
        """Return the number of rows of each table.

        Args:
            timeout_s: Maximum time for each table, in seconds, or None for no limit.

        Returns:
            Number of rows, by the name of the table.

        Raises:
            QueryError: If the count of one table takes longer than `timeout_s`.
        """
        counts = {}
        tables = self.query("CALL show_tables() RETURN name, type", ordered=False).to_pylist()
        for name, kind in sorted((table["name"], table["type"]) for table in tables):
            pattern = f"(n:`{name}`)" if kind == "NODE" else f"()-[r:`{name}`]->()"
            rows = self.query(f"MATCH {pattern} RETURN count(*) AS n", timeout_s=timeout_s)
            counts[name] = int(rows["n"][0].as_py())
        return counts

    def explain(self, cypher: str, params: Mapping[str, Any] | None = None) -> QueryPlan:
        """Return the engine's plan of a statement without running it. Raises QueryError for an invalid statement."""
        text, values = bind(cypher, params or {})
        with self._lock:
            return self._plan(text, values)

    # -- writing ----------------------------------------------------------------------------------------------

    def execute(self, cypher: str, params: Mapping[str, Any] | None = None) -> pa.Table:
        """Run one statement that may write, and return the rows of the statement's result.

        Outside of `transaction()`, the statement has its own transaction.

        Raises:
            QueryError: If the statement is refused or fails, or the session only reads.
            StoreError: If the disk is full or the graph file is damaged.
        """
        text, values = bind(cypher, params or {})
        with self._writing():
            bare = strip_literals(text)
            if _MATCH.search(bare):
                refuse_wrong_answers(self._plan(text, values), text, lambda probe: self._complaint(probe, values))
            elif not _ROW.match(bare):
                # The statement may change tables, so that the stored plans of other statements become wrong.
                self._shared.plans.clear()
            return self._run(text, values, None)

    def copy(self, table: str, rows: pa.Table) -> None:
        """Append rows to a table of the graph. The columns of `rows` must have the order of the table's columns.

        Rows of edges begin with two more columns: the keys of the nodes at the start and at the end of the edge.
        """
        # The engine uses importlib.util, but does not import it.
        import importlib.util  # noqa: F401

        # The engine silently loses rows if the chunks of a column are small.
        self._copy(table, "$rows", {"rows": rows.combine_chunks()})

    def copy_files(self, table: str, folder: Path, names: Sequence[str], ends: Sequence[str] = ()) -> None:
        """Append the rows of Parquet files to a table of the graph.

        The engine would read special characters of a path as wildcards. So the names of the files must be plain, and
        this process changes its current folder to `folder` during the call.

        Args:
            table: Name of the table.
            folder: Folder of the files.
            names: Names of the files. A name has only letters, digits, '.', '_' and '-'.
            ends: Names of the node tables at the start and at the end of the edges. They are needed only if the
                relationship table connects several pairs of node tables.

        Raises:
            QueryError: If a file name is not plain, or the rows do not fit the table.
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
        """Run the statements of a `with` block in one write transaction. An exception undoes all statements."""
        with self._writing():
            self._run("BEGIN TRANSACTION", {}, None)
            self._in_transaction = True
            try:
                yield
            except BaseException:
                # If a statement failed, the engine has already undone the transaction, and ROLLBACK fails.
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
        """Return the engine's error message for a statement, or "" if the statement is valid."""
        # Use a new connection, because an error ends the transaction of its connection.
        with engine().Connection(self._shared.database) as connection:
            try:
                connection.execute(f"EXPLAIN {text}", dict(values))
            except RuntimeError as error:
                return str(error)
        return ""

    def _renew(self) -> None:
        """Replace the connection if it has run `_PREPARED` statements with parameters and no transaction is open."""
        if self._planned >= _PREPARED and not self._in_transaction:
            self._prepared.clear()
            self._connection.close()
            self._connection = engine().Connection(self._shared.database)
            self._planned = 0

    def _statement(self, text: str, values: Mapping[str, Any]) -> Any:
        """Return the prepared statement for a text, or the text itself if the session does not prepare it.

        A statement with an Arrow table as a parameter must not be prepared, because the engine would use the table of
        the first call in all later calls.
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
                # Close every result, because the engine crashes if only the last result stays open.
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
    """Yield a session that only reads, and that keeps parsed statements.

    Each session begins without parsed statements, because the engine keeps the memory of their calls until the session
    ends. A worker process keeps the file open for its next sequence, because opening the file and checking statements
    take longer than running most statements. Raises the errors of `Graph.open`.
    """
    if processes.is_worker and path not in _left_open:
        _left_open[path] = Graph.open(path, read_only=True)
    with Graph.open(path, read_only=True, prepares=True) as graph:
        yield graph


_left_open: dict[Path, Graph] = {}


@contextlib.contextmanager
def hold_graph(path: Path, workers: Executor) -> Iterator[None]:
    """Keep the file of `open_worker_graph` open in this process if `workers` is 1.

    This process then handles all sequences itself. The file is opened once, and each statement is checked once. If
    there are several workers, the context manager does nothing, because an open graph takes 150 MB of memory. Raises
    the errors of `Graph.open`.
    """
    with Graph.open(path, read_only=True) if workers == 1 else contextlib.nullcontext():
        yield


@contextlib.contextmanager
def build_graph(path: str | Path, *, extend: bool = False) -> Iterator[Graph]:
    """Yield a session on a temporary graph file, and rename the file to `path` when the `with` block ends.

    The graph is locked until the block ends. If the block raises an exception, the temporary file is removed, and the
    file at `path` does not change.

    Args:
        path: Graph file to create or replace.
        extend: True if the temporary file begins as a copy of the file at `path`, False if it begins empty.

    Raises:
        LockedError: If the file at `path` is open in this process, or another process uses it.
        StoreError: If the file cannot be written.
    """
    target = Path(path).resolve()
    check_unused(target)
    make_parent(target)
    check_room(target)
    with lock_graph(target, shared=False), contextlib.ExitStack() as cleanup:
        temporary = building_path(target)
        # Remove temporary files of a killed process. No running process uses them, because this process has the lock.
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
    """Remove a graph file and its side files. Raises LockedError if another process uses the graph."""
    target = Path(path).resolve()
    with lock_graph(target, shared=False):
        remove_files(target)
