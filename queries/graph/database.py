"""The engine's databases that this process has open: one per path, shared by all its graphs.

The engine's own lock is a POSIX one, which a second opening of the file in the same process silently drops. So each
database is opened once and shared, an `flock` on `<path>.lock` excludes other processes, and nothing else opens the
database file while it is in use.
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
    lock_graph,
    rebuild_hint,
)
from jrdb_avr.schema.catalog import graph_tables
from jrdb_avr.schema.errors import LockedError, QueryError, StoreError, did_you_mean

_MEMORY_BYTES: Final = 1 << 30
"""Address space of an in-memory database; the engine's default of 8 TiB allows only a few in a process."""

_registry: dict[Path | None, SharedDatabase] = {}
_registry_lock = threading.Lock()


def engine() -> Any:
    """The engine's module. Raises StoreError where it is not installed."""
    if ENGINE not in ENGINES.values():
        raise StoreError(f"JRDB_AVR_ENGINE is {ENGINE}: give {' or '.join(ENGINES.values())}")
    try:
        return importlib.import_module(ENGINE)
    except ImportError:
        raise StoreError(f"JRDB_AVR_ENGINE={ENGINE} is not installed: pip install 'jrdb-avr[{ENGINE}]'") from None


@dataclass
class SharedDatabase:
    """A database with its users, its writer lock, the lock of its file if it has one, and the plans of statements."""

    database: Any
    path: Path | None = None
    read_only: bool = False
    lock: IO[str] | None = None
    users: int = 1
    writer: threading.RLock = field(default_factory=threading.RLock)
    plans: dict[str, Any] = field(default_factory=dict)

    def release(self) -> None:
        """Close the database with its last user."""
        with _registry_lock:
            self.users -= 1
            if self.users == 0:
                _registry.pop(self.path, None)
                self.database.close()
                if self.lock is not None:
                    self.lock.close()


def acquire_database(path: Path, read_only: bool, buffer_bytes: int) -> SharedDatabase:
    """The database of the graph file at `path`, a resolved one; opened by its first user. Raises as `Graph.open`."""
    with _registry_lock:
        shared = _registry.get(path)
        if shared is None:
            shared = _registry[path] = _opened(path, read_only, buffer_bytes)
        elif shared.read_only and not read_only:
            raise LockedError(f"{path} is open for reading in this process: close it first", holder="this process")
        else:
            shared.users += 1
        return shared


def memory_database(buffer_bytes: int) -> SharedDatabase:
    """A new empty database in memory, of one thread."""
    return SharedDatabase(
        engine().Database(":memory:", buffer_pool_size=buffer_bytes, max_db_size=_MEMORY_BYTES, max_num_threads=1)
    )


def check_unused(path: Path) -> None:
    """Raise LockedError where this process has the graph file at `path` open."""
    with _registry_lock:
        if path in _registry:
            raise LockedError(f"{path} is open in this process: close it first", holder="this process")


def _opened(path: Path, read_only: bool, buffer_bytes: int) -> SharedDatabase:
    if read_only and path.with_name(path.name + ".shadow").exists():
        # A killed writer left a checkpoint half done; only an opening for writing can finish it.
        with contextlib.suppress(StoreError), lock_graph(path, shared=False):
            _open_file(path, False, buffer_bytes).close()
    if not read_only:
        check_room(path)
    lock = lock_graph(path, shared=read_only)
    try:
        return SharedDatabase(_open_file(path, read_only, buffer_bytes), path, read_only, lock)
    except BaseException:
        lock.close()
        raise


def _open_file(path: Path, read_only: bool, buffer_bytes: int) -> Any:
    # Before the database is open here, as closing the file would drop the engine's lock on it.
    check_fingerprint(path)
    end = time.monotonic() + ENDING_S
    while True:
        try:
            # One thread: of ORDER BY, several threads now and then hand out their parts one after the other.
            return engine().Database(str(path), read_only=read_only, buffer_pool_size=buffer_bytes, max_num_threads=1)
        except RuntimeError as error:
            if "Could not set lock" not in str(error):
                raise StoreError(f"cannot open {path} ({shortened(str(error))}): {rebuild_hint(path)}") from None
        # A killed process releases the lock of the side file a moment before the engine's.
        if time.monotonic() > end:
            raise LockedError(f"{path} is in use by another process: wait for it", holder="another process")
        time.sleep(0.02)


def translated(error: RuntimeError, text: str, timeout_s: float | None, path: Path | None) -> QueryError | StoreError:
    """An error of the engine on a statement as this program's."""
    message = " ".join(str(error).split())
    if "Interrupted" in message:
        return QueryError(f"stopped after {timeout_s:g} s: {shortened(text)}" if timeout_s else "interrupted")
    if "past the end of the file" in message or "Cannot read from file" in message:
        where = f"{path} is cut short" if path else "the graph file is cut short"
        return StoreError(f"{where}: {rebuild_hint(path)}" if path else where)
    if "Buffer manager exception" in message:
        return QueryError(f"needs more memory than its limit: narrow it (by sequence): {shortened(text)}")
    if "No space left" in message or "File too large" in message or "Cannot write to file" in message:
        return StoreError(f"cannot write the graph: {shortened(message)}; free some space and load again")
    if unknown := re.search(r"Table (\w+) does not exist", message):
        return QueryError(
            f"no table {unknown[1]!r}{did_you_mean(unknown[1], (table.name for table in graph_tables()))}"
        )
    if unknown := re.search(r"Cannot find property (\w+) for (\w+)", message):
        columns = {name for table in graph_tables() for name in table.columns}
        return QueryError(f"{unknown[2]} has no property {unknown[1]!r}{did_you_mean(unknown[1], columns)}")
    # The parser lists everything it would have taken instead, and repeats the statement.
    return QueryError(shortened(re.sub(r" expecting \{.*", "", message), 300))


def shortened(text: str, limit: int = 120) -> str:
    """A text in one line of at most `limit` characters."""
    plain = " ".join(text.split())
    return plain if len(plain) <= limit else plain[: limit - 3] + "..."
