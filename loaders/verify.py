"""Comparison of a store with what was loaded: hashes of its Parquet files and of the graph file.

The manifest holds the hash of each Parquet file, the fingerprint beside the graph holds the hash of the graph file. A
run writes its world models into the graph file, so its hash changes. Then only the row counts of the tables can be
compared. A damaged graph can crash the engine, so the rows are counted in a process of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from jrdb_avr.queries import workers
from jrdb_avr.queries.files import file_hash
from jrdb_avr.queries.graph.file import check_fingerprint, lock_graph
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.manifest import Manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, StoreError
from jrdb_avr.schema.graph import KEYFRAME_NODES, KEYFRAME_RELS, SCENE_NODES, SCENE_RELS

PARTS: Final = ("annotations", "intervals")
"""Folders of a store that a load writes."""
VERIFY_STEPS: Final = len(PARTS) + 1
"""Number of calls of `advance` by `checks_of`."""

TIMEOUT_S: Final = 120.0
"""Maximum time to count the rows of a table. A damaged graph can keep the engine busy forever."""

_BUILT: Final = frozenset((*SCENE_NODES, *SCENE_RELS, *KEYFRAME_NODES, *KEYFRAME_RELS))
"""Tables of the graph that no run writes into."""


@dataclass(frozen=True)
class Check:
    """Result for one part of a store: the number of compared files, and the first fault ("" for none).

    reload: the annotations must be loaded again. A rebuild repairs any other fault.
    """

    what: str
    checked: int
    fault: str
    reload: bool = False


def checks_of(store: Store, advance: Callable[[int], None] = lambda steps: None) -> list[Check]:
    """Compare the files of a store with their hashes.

    Args:
        store: store to verify.
        advance: function that is called with 1 after each part.

    Returns:
        One result per part: annotations, intervals, graph.

    Raises:
        StoreError: there is no manifest.
        LockedError: another process writes the graph.
    """
    manifest = store.manifest()
    checks = []
    with lock_graph(store.graph_path, shared=True):
        for part in PARTS:
            checks.append(_check_files(store, manifest, part))
            advance(1)
        checks.append(Check("graph", 1, _graph_fault(store.graph_path)))
        advance(1)
    return checks


def _check_files(store: Store, manifest: Manifest, part: str) -> Check:
    """Compare the files of a part with their hashes. A file beside them is a fault, because views would read it."""
    digests = {path: digest for entry in manifest.sequences.values() for path, digest in entry.tables.items()}
    expected = {path: digest for path, digest in digests.items() if path.startswith(f"{part}/")}
    results = ((path, _file_fault(store.path / path, digest)) for path, digest in sorted(expected.items()))
    faults = [f"{path} {fault}" for path, fault in results if fault]
    present = {path.relative_to(store.path).as_posix() for path in (store.path / part).rglob("*.parquet")}
    faults += [f"{path} was not written by the load" for path in sorted(present - expected.keys())]
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return Check(part, len(expected), f"{faults[0]}{more}" if faults else "", reload=part == "annotations")


def _file_fault(path: Path, digest: str) -> str:
    try:
        return "" if file_hash(path) == digest else "is not the file that was loaded"
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        return f"cannot be read: {error.strerror}"


def _graph_fault(path: Path) -> str:
    try:
        built = check_fingerprint(path)
        if file_hash(path) == built.sha256:
            return ""
    except StoreError as error:
        return str(error)
    except OSError as error:
        return f"{path.name} cannot be read: {error.strerror}"
    try:
        counts = workers.run_alone(partial(_count_rows, path))
    except (AvrError, RuntimeError, ValueError):
        return f"{path.name} is not the file that was built: the engine cannot read it"
    differ = [table for table in sorted({*built.rows, *counts}) if built.rows.get(table) != counts.get(table)]
    if wrong := [table for table in differ if table in _BUILT]:
        rows, instead = counts.get(wrong[0], 0), built.rows.get(wrong[0], 0)
        return f"{path.name} has {rows} rows of {wrong[0]} instead of {instead}"
    # A dropped world model leaves a longer file with the rows as built.
    written = differ or path.stat().st_size > built.size
    return "" if written else f"{path.name} is not the file that was built, and no run has written into it"


def _count_rows(path: Path) -> dict[str, int]:
    with Graph.open(path, read_only=True) as graph:
        return graph.count_rows(TIMEOUT_S)
