"""The graph file and the two files beside it: the fingerprint and the lock.

The engine does not use checksums, and opens a truncated or replaced file without an error. So the fingerprint
`<graph>.json` is written when the graph file is built. The fingerprint shows whether the graph file is complete, and
whether its tables have the version of this program. `load --verify` also compares the hash in the fingerprint with the
hash of the graph file. The hash is not in the manifest of the store, because equal stores must have equal manifests,
but two builds of the same scene have different bytes.

The lock on `<graph>.lock` admits either one writer or any number of readers.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Final

import msgspec

from jrdb_avr.queries.files import file_hash, lock_file
from jrdb_avr.schema.errors import LockedError, StoreError
from jrdb_avr.schema.graph import STORAGE_VERSION

ENGINES: Final = {b"KUZU": "kuzu", b"LBUG": "ladybug"}
"""Names of the engines' Python modules, by the first four bytes of the files that the engine writes."""

ENGINE: Final = os.environ.get("JRDB_AVR_ENGINE") or "kuzu"
"""Name of the Python module of the engine in use. Tests use `ladybug`, a fork of `kuzu` (docs/graph.md)."""

STORE_GRAPH: Final = "graph.kuzu"
"""Name of the graph file in a store."""

PAGE: Final = 4096
"""Size of the engine's pages, in bytes."""

ENDING_S: Final = 5.0
"""Maximum time to wait for the lock of a process that is about to end, in seconds."""

_LEAST_FREE: Final = 32 << 20
"""Free space, in bytes, that the disk needs before a write. If the disk is full, the engine may abort the process."""

_SIDE_FILES: Final = (".wal", ".shadow", ".tmp")


class Fingerprint(msgspec.Struct, frozen=True):
    """Properties of a graph file at the time when it was built.

    Attributes:
        storage_version: Version of the tables.
        size: Size of the file in bytes.
        sha256: Hash of the file, in hexadecimal digits.
        rows: Number of rows of each table, by the name of the table.
    """

    storage_version: int
    size: int
    sha256: str
    rows: dict[str, int]


def fingerprint_path(graph: Path) -> Path:
    """Return the path of a graph file's fingerprint."""
    return graph.with_name(graph.name + ".json")


def building_path(graph: Path) -> Path:
    """Return the path of the temporary file that is renamed to the graph file when the temporary file is complete."""
    return graph.with_name(f".{graph.name}.building")


def compute_fingerprint(file: Path, rows: Mapping[str, int]) -> Fingerprint:
    """Return the fingerprint of a finished graph file.

    Args:
        file: Graph file.
        rows: Number of rows of each table, by the name of the table.

    Returns:
        The fingerprint.

    Raises:
        OSError: If the file cannot be read.
    """
    return Fingerprint(STORAGE_VERSION, file.stat().st_size, file_hash(file), dict(rows))


def is_as_built(graph: Path) -> bool:
    """Return whether a graph file still has the hash that it had when it was built.

    Args:
        graph: Graph file.

    Returns:
        Whether the hashes are equal. They differ if a run has written its world models into the file since then.

    Raises:
        StoreError: If the graph or its fingerprint is missing or damaged, or has another version.
    """
    return check_fingerprint(graph).sha256 == file_hash(graph)


def check_fingerprint(graph: Path) -> Fingerprint:
    """Check the version, the first bytes and the size of a graph file, and return its stored fingerprint.

    Do not call this function while the process has the database open. This function opens and closes the file, and
    closing it would drop the engine's lock.

    Args:
        graph: Graph file.

    Returns:
        The fingerprint from the time when the file was built.

    Raises:
        StoreError: If the graph or its fingerprint is missing or damaged, or has another version. The message says how
            to build the graph file again.
    """
    rebuild = describe_rebuild(graph)
    with contextlib.suppress(OSError):
        _rename_fingerprint(graph)
    try:
        size = graph.stat().st_size
        with graph.open("rb") as file:
            engine = ENGINES.get(file.read(4))
    except FileNotFoundError:
        raise StoreError(f"{graph} does not exist: {rebuild}") from None
    except OSError as error:
        raise StoreError(f"cannot read {graph}: {error.strerror}") from None
    try:
        built = msgspec.json.decode(fingerprint_path(graph).read_bytes(), type=Fingerprint)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        raise StoreError(f"{graph} has no readable {fingerprint_path(graph).name} beside it: {rebuild}") from None
    if built.storage_version != STORAGE_VERSION:
        raise StoreError(
            f"{graph} has version {built.storage_version} of the tables, this program has {STORAGE_VERSION}: {rebuild}"
        )
    if engine not in (None, ENGINE):
        raise StoreError(f"{graph} is a file of {engine}, not of {ENGINE}: set JRDB_AVR_ENGINE={engine}, or {rebuild}")
    if engine is None or size < built.size:
        raise StoreError(f"{graph} is not a complete graph file: {rebuild}")
    return built


def describe_rebuild(graph: Path) -> str:
    """Return advice for error messages on how to build a graph file again.

    If the file is the graph of a store, the advice names a command. If it is the graph of a run in progress, the
    advice is to remove the file, because the next run makes a new one.
    """
    if graph.name != STORE_GRAPH:
        return "give another file, or remove this one: the next run makes a new one"
    return f"run 'jrdb-avr load --rebuild --store {graph.parent}'"


def lock_graph(path: Path, *, shared: bool) -> IO[str]:
    """Lock a graph until the returned file is closed.

    If the folder is read-only, a reader may get a file without a lock. A lock is then not needed, because other
    processes cannot write to the folder either.

    Args:
        path: Graph file.
        shared: True for a reader, False for a writer.

    Returns:
        The open file that holds the lock.

    Raises:
        LockedError: If another process holds the lock. The message names that process.
        StoreError: If the lock file cannot be opened, or the file system has no locks.
    """
    lock = path.with_name(path.name + ".lock")
    try:
        file = lock.open("a+")
    except OSError as error:
        if not (shared and path.exists()):
            raise StoreError(f"cannot use {path}: {error.strerror}; check the --store folder") from None
        try:
            file = lock.open("r")
        except OSError:
            return Path(os.devnull).open()
    end = time.monotonic() + ENDING_S
    while not lock_file(file, shared=shared):
        holder, ends = _holder(file)
        if not ends or time.monotonic() > end:
            file.close()
            raise LockedError(f"{path} is in use by {holder}: wait for it, or end it", holder=holder)
        time.sleep(0.02)
    return file


def _holder(file: IO[str]) -> tuple[str, bool]:
    """Return a description of the process that holds a lock, and whether the lock is about to become free.

    The function looks for the process in the kernel's table of locks. The second value is true if that process is
    about to end. It is also true if the table does not list a process, because the lock has then just been released.
    Without the table, as on macOS or if another machine holds the lock, the process is not named.
    """
    ends = False
    inode = str(os.fstat(file.fileno()).st_ino)
    with contextlib.suppress(OSError):
        locks = Path("/proc/locks").read_text()
        ends = True
        for line in locks.splitlines():
            fields = line.split()
            if "FLOCK" in fields and len(fields) > 5 and fields[5].rpartition(":")[2] == inode and fields[4] != "-1":
                # A process that is about to end has no command line.
                command = Path("/proc", fields[4], "cmdline").read_bytes().decode(errors="replace").rstrip("\0")
                return f"process {fields[4]} ({command.replace(chr(0), ' ')[:120]})", not command
    return "another process", ends


def make_parent(graph: Path) -> None:
    """Create the folder of a graph file. Raises StoreError if the folder cannot be created."""
    try:
        graph.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"cannot write to {graph.parent}: {error.strerror}; choose another --store") from None


def check_room(graph: Path) -> None:
    """Raise StoreError if the disk of a graph file is nearly full."""
    with contextlib.suppress(OSError):
        if shutil.disk_usage(graph.parent).free < _LEAST_FREE:
            raise StoreError(
                f"cannot write {graph}: less than {_LEAST_FREE >> 20} MB are free on its disk; "
                "free some space and run it again"
            )


def publish(temporary: Path, graph: Path, rows: Mapping[str, int]) -> None:
    """Write the fingerprint of a finished graph file, and give both files their final names.

    Args:
        temporary: Finished graph file under its temporary name.
        graph: Final path of the graph file.
        rows: Number of rows of each table, by the name of the table.

    Raises:
        StoreError: If a file cannot be written or renamed.
    """
    try:
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        # Remove the log of the old file first, because the engine would apply it to the new file.
        for suffix in _SIDE_FILES:
            graph.with_name(graph.name + suffix).unlink(missing_ok=True)
        fingerprint_path(temporary).write_bytes(msgspec.json.encode(compute_fingerprint(temporary, rows)))
        temporary.replace(graph)
        _rename_fingerprint(graph)
    except OSError as error:
        raise StoreError(f"cannot write {graph}: {error.strerror}; free some space and run the command again") from None


def _rename_fingerprint(graph: Path) -> None:
    """Rename the fingerprint to its final name if the graph file has its final name already.

    A process may have died after it renamed the graph file and before it renamed the fingerprint.
    """
    temporary = building_path(graph)
    if not temporary.exists():
        with contextlib.suppress(FileNotFoundError):
            fingerprint_path(temporary).replace(fingerprint_path(graph))


def copy_files(graph: Path, copy: Path) -> None:
    """Copy the graph file `graph` to the path `copy`, and also copy the log of the graph file.

    Raises StoreError if the graph is damaged or a copy cannot be written.
    """
    check_fingerprint(graph)
    try:
        for suffix in ("", *_SIDE_FILES):
            if (file := graph.with_name(graph.name + suffix)).exists():
                shutil.copyfile(file, copy.with_name(copy.name + suffix))
    except OSError as error:
        raise StoreError(f"cannot write {copy}: {error.strerror}; free some space") from None


def remove_files(graph: Path) -> None:
    """Remove a graph file and all its side files except the lock file."""
    # Remove the fingerprint first. A fingerprint without a graph file would look like one that must be renamed.
    for path in (fingerprint_path(graph), graph, *(graph.with_name(graph.name + suffix) for suffix in _SIDE_FILES)):
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
