"""The graph file with its side files: the fingerprint and the lock.

The engine has no page checksums, and opens a truncated or replaced file without an error. The fingerprint
`<graph>.json` is written when the file is built. It shows whether the file is complete and has this program's tables.
`load --verify` compares its hash with the file. The hash is not in the manifest, because two builds of the same scene
differ in their bytes, and manifests of equal stores are equal.

The lock is on a side file, `<graph>.lock`, and admits one writer or any number of readers.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Final

import msgspec

from jrdb_avr.queries.files import file_hash
from jrdb_avr.schema.errors import LockedError, StoreError
from jrdb_avr.schema.graph import STORAGE_VERSION

ENGINES: Final = {b"KUZU": "kuzu", b"LBUG": "ladybug"}
"""Module names of the engines by the first four bytes of their files."""

ENGINE: Final = os.environ.get("JRDB_AVR_ENGINE") or "kuzu"
"""Module name of this process's engine. `ladybug`, a fork of `kuzu`, is for tests of its releases (docs/graph.md)."""

STORE_GRAPH: Final = "graph.kuzu"
"""Name of a store's graph file."""

PAGE: Final = 4096
"""Size of the engine's pages, in bytes."""

ENDING_S: Final = 5.0
"""Maximum time to wait for the lock of a process that was just killed, in seconds."""

_LEAST_FREE: Final = 32 << 20
"""Minimum free space before a graph is written, in bytes. The engine may abort the process if the disk is full."""

_SIDE_FILES: Final = (".wal", ".shadow", ".tmp")


class Fingerprint(msgspec.Struct, frozen=True):
    """Properties of a graph file when it was built: version of its tables, size in bytes, sha256 and rows per table."""

    storage_version: int
    size: int
    sha256: str
    rows: dict[str, int]


def fingerprint_path(graph: Path) -> Path:
    """Return the path of a graph file's fingerprint."""
    return graph.with_name(graph.name + ".json")


def building_path(graph: Path) -> Path:
    """Return the path of the temporary file in which a graph is built."""
    return graph.with_name(f".{graph.name}.building")


def compute_fingerprint(file: Path, rows: Mapping[str, int]) -> Fingerprint:
    """Return the fingerprint of a finished graph file with its rows per table. Raises OSError."""
    return Fingerprint(STORAGE_VERSION, file.stat().st_size, file_hash(file), dict(rows))


def is_as_built(graph: Path) -> bool:
    """Return whether a graph file has the hash in its fingerprint. Raises as `check_fingerprint`."""
    return check_fingerprint(graph).sha256 == file_hash(graph)


def check_fingerprint(graph: Path) -> Fingerprint:
    """Return the stored fingerprint of a graph file after a check of the file's first bytes and size.

    Do not call this while this process has the database open, because closing the file drops the engine's lock.

    Raises:
        StoreError: The graph or its fingerprint is missing, cut short or of another version; the message gives the
            command to rebuild.
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
            f"{graph} was built for version {built.storage_version} of the tables, this is {STORAGE_VERSION}: {rebuild}"
        )
    if engine not in (None, ENGINE):
        raise StoreError(f"{graph} is a file of {engine}, not of {ENGINE}: set JRDB_AVR_ENGINE={engine}, or {rebuild}")
    if engine is None or size < built.size:
        raise StoreError(f"{graph} is not a complete graph file: {rebuild}")
    return built


def describe_rebuild(graph: Path) -> str:
    """Return how to rebuild a graph file: by a command in a store, or by the next run for a file of world models."""
    if graph.name != STORE_GRAPH:
        return "give another file, or remove this one: the next run makes a new one"
    return f"run 'jrdb-avr load --rebuild --store {graph.parent}'"


def lock_graph(path: Path, *, shared: bool) -> IO[str]:
    """Lock a graph until the returned file is closed.

    Reading needs no lock in a folder that cannot be written.

    Args:
        path: Graph file.
        shared: True to read, False to write.

    Returns:
        The open lock file.

    Raises:
        LockedError: Another process holds the lock; the message names it.
        StoreError: The lock file cannot be opened.
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
    while True:
        try:
            fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
            break
        except OSError:
            holder, ends = _holder(file)
            if not ends or time.monotonic() > end:
                file.close()
                raise LockedError(f"{path} is in use by {holder}: wait for it, or end it", holder=holder) from None
            time.sleep(0.02)
    if not shared:
        file.truncate(0)
        file.write(f"process {os.getpid()}")
        file.flush()
    return file


def _holder(file: IO[str]) -> tuple[str, bool]:
    """Return the holder of the lock, and whether that process is about to end.

    The holder is taken from the kernel's table of locks, or from the file if there is no table. If the table does not
    list a holder, it has released the lock meanwhile.
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
    file.seek(0)
    return file.read(100).strip() or "another process", ends


def make_parent(graph: Path) -> None:
    """Make the folder of a graph file. Raises StoreError if the disk refuses."""
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
    """Rename a finished graph file with these rows per table, and write its fingerprint.

    Raises StoreError if the disk refuses.
    """
    try:
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        # Remove the old log first, because the engine would replay it into the new file.
        for suffix in _SIDE_FILES:
            graph.with_name(graph.name + suffix).unlink(missing_ok=True)
        fingerprint_path(temporary).write_bytes(msgspec.json.encode(compute_fingerprint(temporary, rows)))
        temporary.replace(graph)
        _rename_fingerprint(graph)
    except OSError as error:
        raise StoreError(f"cannot write {graph}: {error.strerror}; free some space and run the command again") from None


def _rename_fingerprint(graph: Path) -> None:
    """Rename the fingerprint of a graph that was renamed, also after a process was killed between the two."""
    temporary = building_path(graph)
    if not temporary.exists():
        with contextlib.suppress(FileNotFoundError):
            fingerprint_path(temporary).replace(fingerprint_path(graph))


def copy_files(graph: Path, copy: Path) -> None:
    """Copy a graph file with its log. Raises StoreError if the file is damaged or the disk refuses."""
    check_fingerprint(graph)
    try:
        for suffix in ("", *_SIDE_FILES):
            if (file := graph.with_name(graph.name + suffix)).exists():
                shutil.copyfile(file, copy.with_name(copy.name + suffix))
    except OSError as error:
        raise StoreError(f"cannot write {copy}: {error.strerror}; free some space") from None


def remove_files(graph: Path) -> None:
    """Remove a graph file and its side files except the lock."""
    # Remove the fingerprint first, because one without a graph looks like one that is still to be renamed.
    for path in (fingerprint_path(graph), graph, *(graph.with_name(graph.name + suffix) for suffix in _SIDE_FILES)):
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
