"""The seal of a graph file: what it was when it was built, kept beside it as `<graph>.json`.

The engine has no page checksums and opens a file that was cut short or swapped without a word. The seal tells at once
whether the file is whole and of this program's tables. Its checksum, which takes a read of the whole file, is what
`load --verify` compares.

It is no part of the manifest, because two builds of the same scene differ in their bytes.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Final

import msgspec

from jrdb_avr.schema.errors import StoreError
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
