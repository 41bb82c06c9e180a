"""Check that the files of a store are the files that `load` wrote.

The manifest holds the hash of each Parquet file. The fingerprint, a file beside the graph file, holds the hash of the
graph file. A run writes its world models into the graph file, so the hash of the graph file changes. After a run, two
other checks replace the comparison of hashes: the size of the graph file must be that of a complete file, and the
tables that the load has filled must have the row counts in the fingerprint. Rows are counted in a separate process,
because a damaged graph can crash the engine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from jrdb_avr.queries import workers
from jrdb_avr.queries.files import file_hash
from jrdb_avr.queries.graph.file import PAGE, check_fingerprint, lock_graph
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.manifest import Manifest, refuse_public
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, StoreError
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, SCENE_NODES, SCENE_RELS

PARTS: Final = ("annotations", "intervals")
"""Folders of a store that a load writes."""
VERIFY_STEPS: Final = len(PARTS) + 1
"""Number of times that `checks_of` calls `advance`."""

TIMEOUT_S: Final = 120.0
"""Maximum seconds to count the rows of a table. Without a limit, the engine may never finish on a damaged graph."""

_BUILT: Final = frozenset((*SCENE_NODES, *SCENE_RELS, *LAYER_NODES, *LAYER_RELS))
"""Tables of the graph that no run writes into."""


@dataclass(frozen=True)
class Check:
    """Result of the check of one part of a store."""

    what: str
    """Part: "annotations", "intervals" or "graph"."""
    checked: int
    """Number of compared files."""
    fault: str
    """First fault, or "" if there is none."""
    reload: bool = False
    """True if only a new load repairs a fault of this part, False if a rebuild is enough."""


def checks_of(store: Store, advance: Callable[[int], None] = lambda steps: None) -> list[Check]:
    """Compare the files of a store with the hashes that the load has recorded.

    Args:
        store: store to verify.
        advance: function that is called with 1 after the check of each part.

    Returns:
        One result per part, in this order: annotations, intervals, graph.

    Raises:
        StoreError: If the store has no manifest, or if it is public.
        LockedError: If another process writes the graph.
    """
    refuse_public(store.path, "labels")
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
    """Compare the files of a part with the hashes in the manifest.

    A file without a hash in the manifest is a fault too, because views would read the file.
    """
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
    except (AvrError, RuntimeError, ValueError, MemoryError):
        return f"{path.name} is not the file that was built: the engine cannot read it"
    differ = [table for table in sorted({*built.rows, *counts}) if built.rows.get(table) != counts.get(table)]
    if wrong := [table for table in differ if table in _BUILT]:
        rows, instead = counts.get(wrong[0], 0), built.rows.get(wrong[0], 0)
        return f"{path.name} has {rows} rows of {wrong[0]} instead of {instead}"
    if path.stat().st_size % PAGE:
        return f"{path.name} is not a complete graph file"
    # A killed run leaves rows in the graph, but no world.parquet. After the deletion of a world model, the graph has no
    # rows of the run, but world.parquet remains.
    believed = any(count for table, count in counts.items() if table not in _BUILT)
    written = differ or believed or any(path.parent.glob("runs/*/world.parquet"))
    return "" if written else f"{path.name} is not the file that was built, and no run has written into it"


def _count_rows(path: Path) -> dict[str, int]:
    with Graph.open(path, read_only=True) as graph:
        return graph.count_rows(TIMEOUT_S)
