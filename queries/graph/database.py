"""Databases of the graph engine that this process has open.

All sessions of this process on one graph file share one database.

The engine holds a POSIX lock on the graph file. The kernel drops this lock if the process opens the file a second time
and then closes it. So each database is opened only once, and no other code opens the file while the database is open. A
second lock, an `flock` on `<path>.lock`, excludes other processes.
"""

from __future__ import annotations

import contextlib
import importlib
import re
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final

from jrdb_avr.queries.graph.file import (
    ENDING_S,
    ENGINE,
    ENGINES,
    check_fingerprint,
    check_room,
    describe_rebuild,
    lock_graph,
)
from jrdb_avr.schema.catalog import graph_tables
from jrdb_avr.schema.errors import LockedError, QueryError, StoreError, did_you_mean

_BUFFER_BYTES: Final = 256 << 20
"""Maximum size of the engine's page cache, in bytes. On all of JRDB, no measured query needed more than 256 MB."""

_MEMORY_BYTES: Final = 1 << 30
"""Address space of an in-memory database, in bytes. The engine's default of 8 TiB allows only a few databases."""

UNLIMIT: Final = "the graph engine reserves 16 TB of addresses: run 'ulimit -v unlimited', then this command again"
"""Advice if the address space is limited."""

_registry: dict[Path | None, SharedDatabase] = {}
_registry_lock = threading.Lock()


def engine() -> Any:
    """Import and return the Python module of the graph engine. Raises StoreError if the module is not installed."""
    if ENGINE not in ENGINES.values():
        raise StoreError(f"JRDB_AVR_ENGINE is {ENGINE}: give {' or '.join(ENGINES.values())}")
    try:
        return importlib.import_module(ENGINE)
    except ModuleNotFoundError:
        raise StoreError(f"JRDB_AVR_ENGINE={ENGINE} is not installed: pip install 'jrdb-avr[{ENGINE}]'") from None


@dataclass
class SharedDatabase:
    """Open database of the graph engine. Several sessions of this process may share the database.

    Attributes:
        database: Database object of the engine.
        path: Graph file, or None if the database is in memory.
        read_only: Whether the database is open for reading only.
        lock: Lock file, which is open, or None if the database is in memory.
        users: Number of open sessions.
        writer: Lock that a session holds while it writes.
        plans: Plans that the engine made for statements, by the text of the statement.
    """

    database: Any
    path: Path | None = None
    read_only: bool = False
    lock: IO[str] | None = None
    users: int = 1
    writer: threading.RLock = field(default_factory=threading.RLock)
    plans: dict[str, Any] = field(default_factory=dict)

    def release(self) -> None:
        """Subtract one session from `users`. If no session is left, close the database."""
        with _registry_lock:
            self.users -= 1
            if self.users == 0:
                _registry.pop(self.path, None)
                self.database.close()
                if self.lock is not None:
                    self.lock.close()


def acquire_database(path: Path, read_only: bool) -> SharedDatabase:
    """Return the database of a graph file for a new session. Open the database if no session has it open.

    Args:
        path: Resolved path of the graph file.
        read_only: Whether the session only reads.

    Returns:
        The database. Each session must call `release` once.

    Raises:
        StoreError: If the file is missing or damaged, or has another version.
        LockedError: If a lock of another process excludes this session. Also if the session writes, but this process
            already has the database open for reading only.
    """
    with _registry_lock:
        shared = _registry.get(path)
        if shared is None:
            shared = _registry[path] = _open_database(path, read_only)
        elif shared.read_only and not read_only:
            raise LockedError(f"{path} is open for reading in this process: close it first", holder="this process")
        else:
            shared.users += 1
        return shared


def create_memory_database() -> SharedDatabase:
    """Create an empty database in memory that uses one thread."""
    size = {"buffer_pool_size": _BUFFER_BYTES, "max_db_size": _MEMORY_BYTES}
    return SharedDatabase(engine().Database(":memory:", max_num_threads=1, **size))


def check_unused(path: Path) -> None:
    """Raise LockedError if this process has the graph file open."""
    with _registry_lock:
        if path in _registry:
            raise LockedError(f"{path} is open in this process: close it first", holder="this process")


def _open_database(path: Path, read_only: bool) -> SharedDatabase:
    if read_only and path.with_name(path.name + ".shadow").exists():
        # A writer was killed during a checkpoint. Open the database for writing once, because the engine finishes the
        # checkpoint only if the database is open for writing.
        with contextlib.suppress(StoreError), lock_graph(path, shared=False):
            _open_file(path, False).close()
    if not read_only:
        check_room(path)
    lock = lock_graph(path, shared=read_only)
    try:
        return SharedDatabase(_open_file(path, read_only), path, read_only, lock)
    except BaseException:
        lock.close()
        raise


def _open_file(path: Path, read_only: bool) -> Any:
    # Check the file before the database is open. Later, the check would drop the engine's lock as it closes the file.
    check_fingerprint(path)
    end = time.monotonic() + ENDING_S
    while True:
        try:
            # Use one thread. With several threads, ORDER BY sometimes sorts only parts of the rows.
            return engine().Database(str(path), read_only=read_only, buffer_pool_size=_BUFFER_BYTES, max_num_threads=1)
        except RuntimeError as error:
            if "Could not set lock" not in str(error):
                advice = UNLIMIT if "Mmap for size" in str(error) else describe_rebuild(path)
                raise StoreError(f"cannot open {path} ({shorten(str(error))}): {advice}") from None
        # The kernel releases the lock on `<path>.lock` of a killed process shortly before the lock of the engine.
        if time.monotonic() > end:
            raise LockedError(f"{path} is in use by another process: wait for it", holder="another process")
        time.sleep(0.02)


def translate_error(
    error: RuntimeError, text: str, timeout_s: float | None, path: Path | None
) -> QueryError | StoreError:
    """Return the exception of this package that replaces an exception of the engine.

    Args:
        error: Exception of the engine.
        text: Statement that failed.
        timeout_s: Maximum time of the statement in seconds, or None for no limit.
        path: Graph file, or None if the database is in memory.

    Returns:
        A StoreError if the file or the disk is at fault, otherwise a QueryError. The message says what the user can do.
    """
    message = " ".join(str(error).split())
    if "Interrupted" in message:
        return QueryError(f"stopped after {timeout_s:g} s: {shorten(text)}" if timeout_s else "interrupted")
    if "past the end of the file" in message or "Cannot read from file" in message:
        damage = f"{path} is cut short" if path else "the graph file is cut short"
        return StoreError(f"{damage}: {describe_rebuild(path)}" if path else damage)
    if "Buffer manager exception" in message:
        advice = UNLIMIT if "Mmap for size" in message else "narrow it (by sequence)"
        return QueryError(f"{shorten(text) or 'the graph'} needs more memory than its limit: {advice}")
    if "No space left" in message or "File too large" in message or "Cannot write to file" in message:
        return StoreError(f"cannot write the graph: {shorten(message)}; free some space and load again")
    if unknown := re.search(r"Table (\w+) does not exist", message):
        return QueryError(
            f"no table {unknown[1]!r}{did_you_mean(unknown[1], (table.name for table in graph_tables()))}"
        )
    if unknown := re.search(r"Cannot find property (\w+) for (\w+)", message):
        columns = {name for table in graph_tables() for name in table.columns}
        return QueryError(f"{unknown[2]} has no property {unknown[1]!r}{did_you_mean(unknown[1], columns)}")
    # Cut the end of a parser's message, because it lists all expected tokens and repeats the statement.
    return QueryError(shorten(re.sub(r" expecting \{.*", "", message), 300))


def shorten(text: str, limit: int = 120) -> str:
    """Return a text in one line of at most `limit` characters. A longer text is cut and ends with "..."."""
    plain = " ".join(text.split())
    return plain if len(plain) <= limit else plain[: limit - 3] + "..."
