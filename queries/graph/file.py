"""The graph file: its fingerprint beside it, its lock, and its place on the disk.

The engine has no page checksums and opens a file that was cut short or swapped without an error. The fingerprint,
`<graph>.json`, is written when the file is built. It shows whether the file is whole and has this program's tables.
`load --verify` compares its hash with the file. The hash is not in the manifest, because two builds of the same scene
differ in their bytes, and manifests of equal stores are equal.

The lock is a side file, `<graph>.lock`: one writer, or any number of readers.
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
"""The engines by the first bytes of their files."""

ENGINE: Final = os.environ.get("JRDB_AVR_ENGINE") or "kuzu"
"""The engine of this process: kuzu, or ladybug, its fork, to judge a release of it by (docs/graph.md)."""

STORE_GRAPH: Final = "graph.kuzu"
"""The name of a store's graph file."""

PAGE: Final = 4096

ENDING_S: Final = 5.0
"""Seconds to wait for a lock before it counts as held: a process that was just killed keeps it for a moment."""

_LEAST_FREE: Final = 32 << 20
"""Bytes that must be free on the disk before a graph is written: where the engine runs out of them in the middle of a
transaction or a checkpoint, it may abort the whole process."""

_SIDE_FILES: Final = (".wal", ".shadow", ".tmp")


class Fingerprint(msgspec.Struct, frozen=True):
    """A graph file as built: version of its tables, size in bytes, sha256, and rows per table."""

    storage_version: int
    size: int
    sha256: str
    rows: dict[str, int]


def fingerprint_path(graph: Path) -> Path:
    """The place of a graph file's fingerprint."""
    return graph.with_name(graph.name + ".json")


def building_path(graph: Path) -> Path:
    """The place where a graph file is built before it is renamed."""
    return graph.with_name(f".{graph.name}.building")


def fingerprint_of(file: Path, rows: Mapping[str, int]) -> Fingerprint:
    """Return the fingerprint of a finished graph file with its rows per table. Raises OSError."""
    return Fingerprint(STORAGE_VERSION, file.stat().st_size, file_hash(file), dict(rows))


def is_as_built(graph: Path) -> bool:
    """Return whether a graph file has the hash in its fingerprint. Raises as `check_fingerprint`."""
    return check_fingerprint(graph).sha256 == file_hash(graph)


def check_fingerprint(graph: Path) -> Fingerprint:
    """The stored fingerprint of the graph file at `graph`, whose first bytes and size it fits.

    Only to be called while this process has no database open there: closing a file drops the engine's lock on it.
    Raises StoreError with the command to rebuild where the graph or its fingerprint is missing, cut short or of other
    tables.
    """
    rebuild = rebuild_hint(graph)
    with contextlib.suppress(OSError):
        _follow(graph)
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
        raise StoreError(f"{graph} is no whole graph file: {rebuild}")
    return built


def rebuild_hint(graph: Path) -> str:
    """How to make a graph file anew: by one command for a store's own, by the next run for a file of world models."""
    if graph.name != STORE_GRAPH:
        return "give another file, or take this one away: the next run makes it anew"
    return f"run 'jrdb-avr load --rebuild --store {graph.parent}'"


def lock_graph(path: Path, *, shared: bool) -> IO[str]:
    """Take the side-file lock of a graph, until the returned file is closed.

    Raises LockedError naming the holder. Takes no lock for reading in a folder where nobody can write.
    """
    place = path.with_name(path.name + ".lock")
    try:
        file = place.open("a+")
    except OSError as error:
        if not (shared and path.exists()):
            raise StoreError(f"cannot use {path}: {error.strerror}; check the --store folder") from None
        try:
            file = place.open("r")
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
    """The holder of the lock, by the kernel's table where there is one, else by the last writer's note; and whether
    that process is about to end. A holder that the kernel's table no longer lists has released the lock meanwhile.
    """
    ends = False
    inode = str(os.fstat(file.fileno()).st_ino)
    with contextlib.suppress(OSError):
        locks = Path("/proc/locks").read_text()
        ends = True
        for line in locks.splitlines():
            fields = line.split()
            if "FLOCK" in fields and len(fields) > 5 and fields[5].rpartition(":")[2] == inode and fields[4] != "-1":
                # A process that is about to end has no command any more.
                command = Path("/proc", fields[4], "cmdline").read_bytes().decode(errors="replace").rstrip("\0")
                return f"process {fields[4]} ({command.replace(chr(0), ' ')[:120]})", not command
    file.seek(0)
    return file.read(100).strip() or "another process", ends


def make_parent(place: Path) -> None:
    """Make the folder of a graph file. Raises StoreError."""
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"cannot write to {place.parent}: {error.strerror}; choose another --store") from None


def check_room(place: Path) -> None:
    """Raise StoreError where the disk is nearly full."""
    with contextlib.suppress(OSError):
        if shutil.disk_usage(place.parent).free < _LEAST_FREE:
            raise StoreError(
                f"cannot write {place}: less than {_LEAST_FREE >> 20} MB are free on its disk; "
                "free some space and run it again"
            )


def publish(temporary: Path, place: Path, rows: Mapping[str, int]) -> None:
    """Rename a finished graph file with these rows per table to its place, with its fingerprint. Raises StoreError."""
    try:
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        # The old log goes first: beside the new file it would be replayed into it.
        for suffix in _SIDE_FILES:
            place.with_name(place.name + suffix).unlink(missing_ok=True)
        fingerprint_path(temporary).write_bytes(msgspec.json.encode(fingerprint_of(temporary, rows)))
        temporary.replace(place)
        _follow(place)
    except OSError as error:
        raise StoreError(f"cannot write {place}: {error.strerror}; free some space and run the command again") from None


def _follow(place: Path) -> None:
    """Rename the fingerprint after its graph, whoever is killed in between."""
    temporary = building_path(place)
    if not temporary.exists():
        with contextlib.suppress(FileNotFoundError):
            fingerprint_path(temporary).replace(fingerprint_path(place))


def copy_files(place: Path, copy: Path) -> None:
    """Copy a graph file with what its last writer left in its log. Raises StoreError where it is no whole graph or the
    disk refuses."""
    check_fingerprint(place)
    try:
        for suffix in ("", *_SIDE_FILES):
            if (file := place.with_name(place.name + suffix)).exists():
                shutil.copyfile(file, copy.with_name(copy.name + suffix))
    except OSError as error:
        raise StoreError(f"cannot write {copy}: {error.strerror}; free some space") from None


def remove_files(path: Path) -> None:
    """Remove a graph file with all that lies beside it but its lock."""
    # A fingerprint without its graph would be taken for one that has yet to follow.
    for place in (fingerprint_path(path), path, *(path.with_name(path.name + suffix) for suffix in _SIDE_FILES)):
        with contextlib.suppress(OSError):
            place.unlink(missing_ok=True)
