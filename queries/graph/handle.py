"""The one handle on the graph: locks, plan guard, COPY, bound parameters, Arrow out.

Kùzu needs care that every caller would otherwise have to remember:

- *One Database per path per process, one writing process or many reading ones.* The engine's own lock is a POSIX one,
  which a second opening of the file in the same process silently drops. So databases are shared within a process, an
  `flock` on `<path>.lock` keeps processes apart, and nothing else opens the database file while it is in use.
- *Some forms are answered wrongly without a word* (`traps.py`): every distinct statement that matches a pattern is
  explained once, and refused if it is one of them.
- *Row order differs between runs*: a read must be ordered, or return a single row, or say `ordered=False`.
- *Small integers are bound as INT8*, a list by its first rows, an empty list not at all, and a forgotten parameter is
  NULL: parameters are bound here under 64-bit types, and their names must be the statement's.
- *One write transaction at a time*: writers of one database wait for each other.

A `Graph` may be used from several threads, which then wait for each other; open another one for reads side by side.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import msgspec
import pyarrow as pa

from jrdb_avr.queries.graph.file import ENDING_S, check_seal, lock_graph, rebuild_hint, seal_of, seal_path
from jrdb_avr.queries.graph.parameters import bind, strip_literals
from jrdb_avr.queries.graph.wrong_answers import Plan, refuse_wrong_answers
from jrdb_avr.schema.errors import LockedError, QueryError, StoreError

BUFFER_BYTES: Final = 512 << 20
"""Hard limit of the engine's page cache; 256 MB held every query measured at full size."""

BUILD_BYTES: Final = 800 << 20
"""The same while a graph is built: COPY holds every row of a batch, in both directions of an edge."""

_MEMORY_BYTES: Final = 1 << 30
"""Address space of an in-memory database; the engine's default of 8 TiB allows only a few in a process."""

_ONE_CHUNK: Final = 100_000
"""Rows up to which a result is one chunk of its own size; the engine's own are of ten million cells, full or not."""

_PREPARED: Final = 256
"""Statements that a graph keeps prepared at a time: parsed, that is; the engine plans them at each use. Also plannings
before a connection is given up for a new one: the engine keeps every statement that was given to it with parameters,
half a megabyte each and more, until its connection ends."""

_LEAST_FREE: Final = 32 << 20
"""Bytes that must be free on the disk of a graph that is to be written: where the engine runs out of them in the middle
of a transaction or a checkpoint, it may abort the whole process."""

_SIDE_FILES: Final = (".wal", ".shadow", ".tmp")

_MATCH = re.compile(r"\bMATCH\b", re.IGNORECASE)
_ROW = re.compile(r"\s*CREATE\s*\(", re.IGNORECASE)


class _Shared:
    """A Database that the Graphs of this process share, with its lock file and writer lock."""

    def __init__(self, path: Path, read_only: bool, buffer_bytes: int, threads: int) -> None:
        self.read_only = read_only
        self.users = 0
        self.writer = threading.RLock()
        if read_only and path.with_name(path.name + ".shadow").exists():
            _recover(path, buffer_bytes)
        if not read_only:
            _check_room(path)
        self.lock = lock_graph(path, shared=read_only)
        try:
            self.database = _open_database(path, read_only, buffer_bytes, threads)
        except BaseException:
            if self.lock is not None:
                self.lock.close()
            raise

    def close(self) -> None:
        self.database.close()
        if self.lock is not None:
            self.lock.close()


_registry: dict[Path, _Shared] = {}
_registry_lock = threading.Lock()


class Graph:
    """A session on a graph. Made by `Graph.open` or `Graph.memory`; a context manager; closed once used."""

    def __init__(
        self, database: Any, writer: threading.RLock, path: Path | None, read_only: bool, prepares: bool = False
    ) -> None:
        import kuzu

        self.path = path
        self.read_only = read_only
        self._database = database
        self._writer = writer
        self._lock = threading.RLock()
        self._connection = kuzu.Connection(database)
        self._plans: dict[str, Plan] = {}
        self._prepares = prepares
        self._prepared: dict[str, Any] = {}
        self._planned = 0
        self._in_transaction = False
        self._failed = False
        self._closed = False

    # -- opening ----------------------------------------------------------------------------------------------

    @classmethod
    def open(
        cls,
        path: str | Path,
        *,
        read_only: bool = False,
        buffer_bytes: int = BUFFER_BYTES,
        threads: int = 0,
        prepares: bool = False,
    ) -> Graph:
        """Open the graph file at `path`, made by `build_graph`.

        threads: of the engine, as many as there are processors where 0; who opens the file first in this process
        decides. prepares: statements with parameters are parsed once for many uses, which halves the time of small
        ones.
        Raises StoreError where there is none, or one that is cut short or of another version, and LockedError naming
        the holder where another process writes it (or, for writing, reads it).
        """
        place = Path(path).resolve()
        with _registry_lock:
            shared = _registry.get(place)
            if shared is None:
                shared = _registry[place] = _Shared(place, read_only, buffer_bytes, threads)
            elif shared.read_only and not read_only:
                raise LockedError(f"{path} is open for reading in this process: close it first", holder="this process")
            shared.users += 1
        return cls(shared.database, shared.writer, place, read_only, prepares)

    @classmethod
    def memory(cls, *, buffer_bytes: int = BUFFER_BYTES, threads: int = 1, prepares: bool = False) -> Graph:
        """A new empty graph in memory, for a worker's own sequence; prepares: as of `open`."""
        import kuzu

        database = kuzu.Database(
            ":memory:", buffer_pool_size=buffer_bytes, max_db_size=_MEMORY_BYTES, max_num_threads=threads
        )
        return cls(database, threading.RLock(), None, False, prepares)

    def close(self) -> None:
        """Give the graph back; the file is let go with its last user in this process. Closing twice is harmless."""
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
            if self.path is None:
                self._database.close()
                return
            with _registry_lock:
                shared = _registry[self.path]
                shared.users -= 1
                if shared.users == 0:
                    del _registry[self.path]
                    shared.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        needs an ORDER BY, unless `ordered=False` says that its order does not matter. Raises QueryError where the
        statement is refused (its plan would lose rows, it writes, its order is open), fails, or takes too long.
        """
        text, values = bind(cypher, params or {})
        with self._lock:
            plan = self._plan(text, values)
            refuse_wrong_answers(plan, text)
            if plan.writes:
                raise QueryError(f"this statement writes, use execute(): {_short(cypher)}")
            if ordered and not plan.ordered:
                raise QueryError(f"add an ORDER BY, or say ordered=False, to: {_short(cypher)}")
            return self._run(text, values, timeout_s)

    def explain(self, cypher: str, params: Mapping[str, Any] | None = None) -> Plan:
        """The engine's plan of a statement. Raises QueryError where it cannot be planned."""
        text, values = bind(cypher, params or {})
        with self._lock:
            return self._plan(text, values)

    # -- writing ----------------------------------------------------------------------------------------------

    def execute(self, cypher: str, params: Mapping[str, Any] | None = None) -> pa.Table:
        """Run one statement that may write, alone or inside `transaction()`. Raises QueryError, StoreError."""
        text, values = bind(cypher, params or {})
        with self._writing(), self._lock:
            bare = strip_literals(text)
            if _MATCH.search(bare):
                refuse_wrong_answers(self._plan(text, values), text)
            elif not _ROW.match(bare):
                # A change of tables may change every plan.
                self._plans.clear()
            return self._run(text, values, None)

    def copy(self, table: str, rows: pa.Table) -> None:
        """Append rows to a table of the graph; columns in the table's order, for edges the two keys first."""
        # The engine looks for pandas by importlib.util, and fails where nobody has imported it yet.
        import importlib.util  # noqa: F401

        # Of a column in chunks the engine reads the rows of small ones only in part, silently.
        rows = rows.combine_chunks()
        with self._writing(), self._lock:
            self._plans.clear()
            self._run(f"COPY `{_identifier(table)}` FROM $rows", {"rows": rows}, None)

    def copy_files(self, table: str, folder: Path, names: Sequence[str]) -> None:
        """As `copy`, from Parquet files of a folder.

        The engine takes a path for a pattern, so the names must be plain ones and the process changes to the folder
        meanwhile: whatever that is called is no matter then.
        """
        if any(not re.fullmatch(r"[A-Za-z0-9._-]+", name) for name in names):
            raise QueryError("a file to copy from needs a plain name")
        files = ", ".join(f"'{name}'" for name in names)
        with self._writing(), self._lock, contextlib.chdir(folder):
            self._plans.clear()
            self._run(f"COPY `{_identifier(table)}` FROM [{files}]", {}, None)

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """One write transaction round the statements inside; an error rolls all of them back."""
        with self._writing(), self._lock:
            self._run("BEGIN TRANSACTION", {}, None)
            self._in_transaction = True
            try:
                try:
                    yield
                except BaseException:
                    # The engine has already rolled back if one of its own statements failed.
                    with contextlib.suppress(QueryError, StoreError):
                        self._run("ROLLBACK", {}, None)
                    raise
                self._run("COMMIT", {}, None)
            finally:
                self._in_transaction = False

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        if self.read_only:
            raise QueryError("the graph is open for reading only")
        with self._writer:
            yield

    # -- the engine -------------------------------------------------------------------------------------------

    def _plan(self, text: str, values: Mapping[str, Any]) -> Plan:
        plan = self._plans.get(text)
        if plan is None:
            plan = Plan(str(self._run(f"EXPLAIN {text}", values, None).column(0)[0].as_py()))
            if len(self._plans) >= _PREPARED:
                self._plans.clear()
            self._plans[text] = plan
        return plan

    def _renew(self) -> None:
        """A new connection in place of one that holds much that was planned; not within a transaction, which is its."""
        if self._planned >= _PREPARED and not self._in_transaction:
            import kuzu

            self._prepared.clear()
            self._connection.close()
            self._connection = kuzu.Connection(self._database)
            self._planned = 0

    def _statement(self, text: str, values: Mapping[str, Any]) -> Any:
        """What the engine is to execute: the text, or it prepared; never prepared where rows are handed in, as the
        engine would keep those of the first use.
        """
        rows = any(isinstance(value, pa.Table) for value in values.values())
        if not (self._prepares and values) or rows or text.startswith("EXPLAIN"):
            self._planned += bool(values)
            return text
        kept = self._prepared.get(text)
        if kept is None:
            import kuzu

            kept = kuzu.PreparedStatement(self._connection, text, dict(values))
            self._planned += 1
            if len(self._prepared) >= _PREPARED:
                self._prepared.clear()
            self._prepared[text] = kept
        return kept

    def _run(self, text: str, values: Mapping[str, Any], timeout_s: float | None) -> pa.Table:
        if self._closed:
            raise QueryError("the graph is closed")
        try:
            self._renew()
            self._connection.set_query_timeout(0 if timeout_s is None else max(1, round(timeout_s * 1000)))
            result = self._connection.execute(self._statement(text, values), dict(values))
            if isinstance(result, list):
                # The rest must go first: the engine crashes when only the last result is kept.
                for part in result:
                    part.close()
                raise QueryError(f"one statement at a time: {_short(text)}")
            try:
                # Statements of control (CHECKPOINT, BEGIN) have no columns at all.
                if not result.get_column_names():
                    return pa.table({})
                rows = result.get_num_tuples()
                return result.get_as_arrow(max(rows, 1) if rows < _ONE_CHUNK else None)
            finally:
                result.close()
        except RuntimeError as error:
            translated = _translated(error, text, timeout_s, self.path)
            self._failed |= isinstance(translated, StoreError)
            raise translated from None


@contextlib.contextmanager
def build_graph(path: str | Path, *, buffer_bytes: int = BUILD_BYTES) -> Iterator[Graph]:
    """Build a graph beside `path` and rename it in when the block ends well; otherwise the old one stays.

    Holds the graph's lock throughout. Raises LockedError where anybody has the graph open, StoreError where the disk
    refuses.
    """
    place = Path(path).resolve()
    with _registry_lock:
        if place in _registry:
            raise LockedError(f"{path} is open in this process: close it first", holder="this process")
    _make_parent(place)
    _check_room(place)
    lock = lock_graph(place, shared=False)
    temporary = place.with_name(f".{place.name}.building")
    try:
        # What a killed builder left behind; the lock says that nobody is at it.
        _remove(temporary)
        import kuzu

        try:
            database = kuzu.Database(str(temporary), buffer_pool_size=buffer_bytes)
        except RuntimeError as error:
            raise _translated(error, "", None, place) from None
        graph = Graph(database, threading.RLock(), None, False)
        try:
            yield graph
            graph.execute("CHECKPOINT")
        finally:
            graph.close()
        try:
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
            # The old log goes first: beside the new file it would be replayed into it.
            for suffix in _SIDE_FILES:
                place.with_name(place.name + suffix).unlink(missing_ok=True)
            seal_path(temporary).write_bytes(msgspec.json.encode(seal_of(temporary)))
            seal_path(temporary).replace(seal_path(place))
            temporary.replace(place)
        except OSError as error:
            raise StoreError(f"cannot write {place}: {error.strerror}; free some space and load again") from None
    finally:
        _remove(temporary)
        if lock is not None:
            lock.close()


def remove_graph(path: str | Path) -> None:
    """Take a graph away, if there is one. Raises LockedError where anybody has it open, StoreError as `lock_graph`."""
    place = Path(path).resolve()
    lock = lock_graph(place, shared=False)
    try:
        _remove(place)
    finally:
        if lock is not None:
            lock.close()


def _open_database(path: Path, read_only: bool, buffer_bytes: int, threads: int) -> Any:
    # Looks at the file only while this process has no database open here, as the seal asks.
    check_seal(path)
    import kuzu

    end = time.monotonic() + ENDING_S
    while True:
        try:
            return kuzu.Database(str(path), read_only=read_only, buffer_pool_size=buffer_bytes, max_num_threads=threads)
        except RuntimeError as error:
            if "Could not set lock" not in str(error):
                raise StoreError(f"cannot open {path} ({_short(str(error))}): {rebuild_hint(path)}") from None
        # A process that is killed lets go of the side file's lock a moment before it lets go of the engine's.
        if time.monotonic() > end:
            raise LockedError(f"{path} is in use by another process: wait for it", holder="another process")
        time.sleep(0.02)


def _recover(path: Path, buffer_bytes: int) -> None:
    """Finish the checkpoint that a killed writer left half done; only an opening for writing can."""
    with contextlib.suppress(StoreError), contextlib.ExitStack() as stack:
        lock = lock_graph(path, shared=False)
        if lock is not None:
            stack.enter_context(lock)
        _open_database(path, False, buffer_bytes, 0).close()


def _translated(error: RuntimeError, text: str, timeout_s: float | None, path: Path | None) -> QueryError | StoreError:
    message = " ".join(str(error).split())
    if "Interrupted" in message:
        return QueryError(f"stopped after {timeout_s:g} s: {_short(text)}" if timeout_s else "interrupted")
    if "past the end of the file" in message or "Cannot read from file" in message:
        where = f"{path} is cut short" if path else "the graph file is cut short"
        return StoreError(f"{where}: {rebuild_hint(path)}" if path else where)
    if "Buffer manager exception" in message:
        return QueryError(f"needs more memory than its limit: narrow it (by sequence): {_short(text)}")
    if "No space left" in message or "File too large" in message or "Cannot write to file" in message:
        return StoreError(f"cannot write the graph: {_short(message)}; free some space and load again")
    # The parser lists everything it would have taken instead, and repeats the statement.
    return QueryError(_short(re.sub(r" expecting \{.*", "", message), 300))


def _identifier(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        raise QueryError(f"{name!r} is no name of a table")
    return name


def _short(text: str, limit: int = 120) -> str:
    plain = " ".join(text.split())
    return plain if len(plain) <= limit else plain[: limit - 3] + "..."


def _check_room(place: Path) -> None:
    """Raise StoreError where the disk is as good as full."""
    with contextlib.suppress(OSError):
        if shutil.disk_usage(place.parent).free < _LEAST_FREE:
            raise StoreError(
                f"cannot write {place}: less than {_LEAST_FREE >> 20} MB are free on its disk; "
                "free some space and run it again"
            )


def _make_parent(place: Path) -> None:
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"cannot write to {place.parent}: {error.strerror}; choose another --store") from None


def _remove(path: Path) -> None:
    for place in (path, seal_path(path), *(path.with_name(path.name + suffix) for suffix in _SIDE_FILES)):
        with contextlib.suppress(OSError):
            place.unlink(missing_ok=True)
