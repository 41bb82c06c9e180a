"""The seal of a graph file: what it was when it was built, kept beside it as `<graph>.json`.

The engine has no page checksums and opens a file that was cut short or swapped without a word. The seal tells at once
whether the file is whole and of this program's tables. Its checksum, which takes a read of the whole file, is what
`load --verify` compares.

It is no part of the manifest, because two builds of the same scene differ in their bytes.

The lock of a graph file: one writer, or any number of readers, told by name to whoever comes in between.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
import zlib
from pathlib import Path
from typing import IO, Final

import msgspec

from jrdb_avr.schema.errors import LockedError, StoreError
from jrdb_avr.schema.graph import STORAGE_VERSION

STORE_GRAPH: Final = "graph.kuzu"
"""The name of a store's graph file."""

PAGE: Final = 4096

_MAGIC: Final = b"KUZU"
_CHUNK: Final = 1 << 20


class Seal(msgspec.Struct, frozen=True):
    """Tables' version, size in bytes, and the CRC-32 of everything after the first page.

    The first page only says where the catalogue lies, and the engine rewrites it when the file is opened for writing.
    """

    storage_version: int
    size: int
    crc32: int


def seal_path(graph: Path) -> Path:
    """Where the seal of a graph file lies."""
    return graph.with_name(graph.name + ".json")


def seal_of(file: Path) -> Seal:
    """The seal of a finished graph file. Raises OSError."""
    with file.open("rb") as opened:
        opened.seek(PAGE)
        checksum = 0
        while chunk := opened.read(_CHUNK):
            checksum = zlib.crc32(chunk, checksum)
        return Seal(STORAGE_VERSION, opened.tell(), checksum)


def check_seal(graph: Path) -> Seal:
    """The seal of the graph file at `graph`, which is whole as far as its first bytes and its size tell.

    Only to be called while this process has no database open there: closing a file drops the engine's lock on it.
    Raises StoreError, saying how to rebuild, where the graph or its seal is missing, cut short or of other tables.
    """
    rebuild = rebuild_hint(graph)
    try:
        size = graph.stat().st_size
        with graph.open("rb") as file:
            magic = file.read(len(_MAGIC))
    except FileNotFoundError:
        raise StoreError(f"{graph} does not exist: {rebuild}") from None
    except OSError as error:
        raise StoreError(f"cannot read {graph}: {error.strerror}") from None
    try:
        seal = msgspec.json.decode(seal_path(graph).read_bytes(), type=Seal)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        raise StoreError(f"{graph} has no readable {seal_path(graph).name} beside it: {rebuild}") from None
    if seal.storage_version != STORAGE_VERSION:
        raise StoreError(
            f"{graph} was built for version {seal.storage_version} of the tables, this is {STORAGE_VERSION}: {rebuild}"
        )
    if magic != _MAGIC or size % PAGE or size < seal.size:
        raise StoreError(f"{graph} is no whole graph file: {rebuild}")
    return seal


def rebuild_hint(graph: Path) -> str:
    """What makes a graph file anew: one command for a store's own, and the next run for agents' world models alone."""
    if graph.name != STORE_GRAPH:
        return "give another file, or take this one away: the next run makes it anew"
    return f"run 'jrdb-avr load --rebuild --store {graph.parent}'"


ENDING_S: Final = 5.0
"""Longest wait for a lock whose holder is about to end."""


def lock_graph(path: Path, *, shared: bool) -> IO[str] | None:
    """Take the side-file lock of a graph, until the file returned is closed.

    Raises LockedError naming the holder. Returns None for reading in a folder where nobody can write.
    """
    place = path.with_name(path.name + ".lock")
    try:
        file = place.open("a+")
    except OSError as error:
        if shared and path.exists():
            try:
                file = place.open("r")
            except OSError:
                return None
        else:
            raise StoreError(f"cannot use {path}: {error.strerror}; check the --store folder") from None
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
    """Who holds the lock, by the kernel's table where there is one, else by what the last writer noted; and whether
    that process is about to end. One that the kernel's table does not name, or that is gone before it is looked at, has
    let go of the lock meanwhile.
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
