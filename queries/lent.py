"""Mirrors on those machines of a cluster that do not see the cache of the machine that runs a command.

There a worker has a mirror of its own at the same path: it fetches the tables or label files of its sequence, is given
the graph, and hands back what it wrote for its sequence into the hidden folders of the store.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from jrdb_avr.queries.files import write_bytes
from jrdb_avr.queries.graph.file import STORE_GRAPH
from jrdb_avr.queries.mirror import OPENED, Mirror

_A = TypeVar("_A")
_R = TypeVar("_R")


@dataclass(frozen=True)
class Lent:
    """A mirror as it travels to workers. `mark` is a file that stands beside it where the command's cache is seen."""

    url: str
    folder: Path
    parts: tuple[str, ...]
    mark: Path
    hidden: tuple[str, ...]
    graph: Any
    """A reference on the cluster to the bytes of the graph's files by their names."""


def lend(put: Callable[[Any], Any]) -> list[Lent]:
    """The mirrors that this process has opened; `put` makes a reference on the cluster. End with `take_back`."""
    lent = []
    for folder, (url, parts) in OPENED.items():
        hidden = tuple(path.name for path in folder.glob(".*") if path.is_dir())
        graph = {path.name: path.read_bytes() for path in folder.glob(f"{STORE_GRAPH}*") if path.suffix != ".lock"}
        mark = folder.with_name(f"driver-{secrets.token_hex(8)}")
        mark.touch()
        lent.append(Lent(url, folder, parts, mark, hidden, put(graph) if graph else None))
    return lent


def take_back(lent: list[Lent]) -> None:
    """Remove the marks of what was lent to workers."""
    for own in lent:
        own.mark.unlink(missing_ok=True)


def away(
    lent: list[Lent], function: Callable[[_A], _R], item: _A, get: Callable[[Any], Mapping[str, bytes]]
) -> tuple[_R, dict[Path, bytes]]:
    """Fetch the files of an item's `sequence` on a worker, and call a function for the item.

    Returns its result, and the files that it wrote for the sequence, which are removed here. Raises StoreError
    where a mirror's URL cannot be reached from here.
    """
    lent = [own for own in lent if not own.mark.exists()]
    sequence: str = getattr(item, "sequence", "")
    for own in lent:
        # What a killed worker left.
        for path in _written(own, sequence):
            path.unlink()
        Mirror(own.url, own.folder.parent).fetch_sequence(
            own.parts, sequence, {} if own.graph is None else get(own.graph)
        )
        for name in own.hidden:
            (own.folder / name).mkdir(exist_ok=True)
    result = function(item)
    written = [path for own in lent for path in _written(own, sequence)]
    files = {path: path.read_bytes() for path in written}
    for path in written:
        path.unlink()
    return result, files


def write_back(files: Mapping[Path, bytes]) -> None:
    """Write what a worker handed back, where it would have written it here. Raises StoreError."""
    for path, data in files.items():
        write_bytes(path, data)


def _written(lent: Lent, sequence: str) -> list[Path]:
    """The files of a sequence in the hidden folders of a mirror."""
    return [path for hidden in lent.folder.glob(".*/") for path in hidden.rglob(f"{sequence}.parquet")]
