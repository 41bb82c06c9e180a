"""Load a JRDB root into a store, or rebuild a store's intervals and graph from its annotation tables.

A load writes all tables into a staging folder inside the store. Then it builds the graph, and counts the rows of the
graph. Finally it moves the new tables into the store, and after them the new manifest. If a load fails, the old store
is unchanged.

If a load was killed before it moved tables, the next load deletes the staging folder. If a load was killed while it
moved tables, the next writer finishes the moves. The tables therefore survive a kill at any moment.

The new graph also holds the world models of the store's finished runs.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Final

import msgspec
import pyarrow as pa

from jrdb_avr.loaders.graph import build_scene, stage_scene, write_graph
from jrdb_avr.loaders.intervals.derive import derive
from jrdb_avr.loaders.intervals.neighbors import beside_warnings
from jrdb_avr.loaders.intervals.persons import disagreements
from jrdb_avr.loaders.intervals.spans import absent_partners
from jrdb_avr.loaders.intervals.timeline import step_of
from jrdb_avr.loaders.layers.boxes_2d import box_warnings, sketch_boxes
from jrdb_avr.loaders.layers.calibration import cameras_check
from jrdb_avr.loaders.problems import shorten
from jrdb_avr.loaders.releases import odd_values
from jrdb_avr.loaders.report import SequenceReport, frame_range, sequence_warnings
from jrdb_avr.loaders.result import LoadResult
from jrdb_avr.loaders.root import Root, SequenceFiles, find_root, total_size
from jrdb_avr.loaders.sequence import NOT_LABELS, annotate, stamps_of
from jrdb_avr.loaders.verify import PARTS
from jrdb_avr.queries.beliefs.graph import make_world_tables
from jrdb_avr.queries.beliefs.record import copy_all
from jrdb_avr.queries.display import Progress, step_counter
from jrdb_avr.queries.files import file_hash
from jrdb_avr.queries.graph.handle import build_graph, remove_graph
from jrdb_avr.queries.manifest import Manifest, SequenceEntry, refuse_newer, refuse_public
from jrdb_avr.queries.runs import run_ids
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import Executor, map_in_order, without_collector
from jrdb_avr.schema.errors import InputError, StoreError, warn
from jrdb_avr.schema.rules import LoadRules, rules_hash
from jrdb_avr.schema.tables import ANNOTATIONS

STAGING: Final = ".loading"
"""Folder inside the store that holds the new files of a load until the load moves them."""
_TABLES: Final = {"2d": "boxes_2d", "3d": "boxes_3d", "pose": "poses"}
"""Annotation tables of layers, if their names differ."""


@dataclass(frozen=True)
class ShardResult:
    """Result of `load_shard`: the report of a sequence, and its entry in the manifest (None if it was not loaded)."""

    report: SequenceReport
    entry: SequenceEntry | None
    sketch: frozenset[int] = frozenset()


def load(
    root: Root | str | Path,
    store: Store | str | Path,
    rules: LoadRules | None = None,
    workers: Executor = 2,
    *,
    layer_dirs: Mapping[str, Sequence[str]] | None = None,
    progress: Progress | None = None,
) -> LoadResult:
    """Load a JRDB root into a store: annotation tables, intervals and the scene graph.

    If sequences lack occlusion attributes, an AvrWarning gives the number of these sequences.

    Args:
        root: folder of a JRDB root, or a root that `find_root` has returned.
        store: store to write, or its folder. The folder is made if it does not exist.
        rules: load rules, or None for the defaults.
        workers: number of processes that share the sequences, or an executor. Every choice gives the same result.
        layer_dirs: by layer, folders that replace the layer's usual folders. Relative paths start at the root. A layer
            with an empty list is not loaded.
        progress: display of the progress.

    Returns:
        One report per sequence. Reports without a sequence hold the problems and notes of the whole root.

    Raises:
        InputError: If no sequence can be loaded. The store is unchanged.
        StoreError: If the store cannot be written. The store is unchanged.
        LockedError: If another process writes the store.
    """
    store, rules = Store.of(store), rules or LoadRules()
    if not isinstance(root, Root):
        root = find_root(root, layer_dirs or {})
    advance = step_counter(progress, "loading", len(root.sequences))
    refuse_newer(store.path)
    with store.writing("load"), _staging(store) as staging:
        shard = partial(load_shard, staging=str(staging.path), rules=rules)
        loaded = map_in_order(shard, root.sequences, workers, lambda files: total_size(files.labels.values()), advance)
        results = dict(zip((files.sequence for files in root.sequences), loaded, strict=True))
        reports = _reports(root, results)
        entries = {name: result.entry for name, result in sorted(results.items()) if result.entry is not None}
        if not entries:
            raise InputError(_nothing(root, reports))
        left_out = _finish(store, staging, root.image_root, rules, entries, PARTS)
        if unclear := store.without_occlusion():
            evidence = "sizes of boxes alone" if rules.visibility == "any" else "nearer boxes and group labels"
            warn(
                f"{len(unclear)} of {len(entries)} sequences have no occlusion attributes, so {evidence} decide "
                "who is in clear view; generate --require-occlusion skips such sequences"
            )
    return LoadResult([*reports, SequenceReport("", [], warnings=left_out)] if left_out else reports)


def rebuild(
    store: Store, rules: LoadRules, workers: Executor = 2, progress: Progress | None = None
) -> dict[str, SequenceEntry]:
    """Derive the intervals and the graph of a store again from its annotation tables.

    If the world model of a run cannot be put into the new graph, an AvrWarning names the run. If a sequence has too
    many facts of relative places, an AvrWarning names the facts that are left out. If a load was killed while it moved
    its tables, call `resume` first.

    Args:
        store: store to rebuild.
        rules: load rules.
        workers: number of processes that share the sequences, or an executor.
        progress: display of the progress.

    Returns:
        The new entry of each sequence in the manifest, by name of the sequence.

    Raises:
        StoreError: If an annotation file is missing, unreadable or changed since the load, if the store is public,
            or if the store cannot be written.
        LockedError: If another process writes the store.
    """
    refuse_public(store.path, "labels")
    with store.writing("load --rebuild"), _staging(store) as staging:
        manifest = store.manifest()
        sequences = sorted(manifest.sequences.items())
        shard = partial(rebuild_shard, store=str(store.path), staging=str(staging.path), rules=rules)
        advance = step_counter(progress, "rebuilding", len(sequences))
        rebuilt = map_in_order(
            shard, sequences, workers, lambda item: total_size([store.annotation_path("boxes_2d", item[0])]), advance
        )
        entries = {name: entry for (name, _), entry in zip(sequences, rebuilt, strict=True)}
        left_out = _finish(store, staging, manifest.image_root, rules, entries, PARTS[1:])
    sightings = {name: store.interval("sightings", name) for name in entries}
    views = [f"{name}: {line}" for name, table in sightings.items() for line in beside_warnings(table)]
    for line in [*left_out, *views]:
        warn(line)
    return entries


def resume(store: Store) -> None:
    """Finish a load that was killed while it moved its tables. Do nothing if the store has no such load.

    The graph is deleted, because it may belong to an earlier load than the tables. `rebuild` makes a new graph.

    Raises:
        LockedError: If another process writes the store.
        StoreError: If the store cannot be written.
    """
    if _half_moved(store):
        with store.writing("load"):
            _finish_moves(store)


# -- one sequence ------------------------------------------------------------------------------------------------


def load_shard(found: SequenceFiles, staging: str, rules: LoadRules) -> ShardResult:
    """Read the files of one sequence, and write its annotation and interval tables into the staging folder."""
    with without_collector(), _one_heap():
        sequence, read = found.sequence, annotate(found)
        files = {
            layer: shorten(f"{Path(path).parent.name}/{Path(path).name}", 200) for layer, path in found.labels.items()
        }
        if not read.frames:
            return ShardResult(SequenceReport(sequence, read.problems, files=files), None)
        intervals = derive(sequence, read.tables, rules)
        entry = _write(Store(staging), sequence, read.tables, intervals)
        tables, cameras = read.tables, cameras_check(read.tables["calibration"])
        labels, images = frame_range(read.label_frames), frame_range(read.frames["images"][0])
        ranges = {
            layer: frame_range(frames, len(tables.get(_TABLES.get(layer, layer), frames)))
            for layer, (frames, _) in read.frames.items()
        }
        occlusions = tables["boxes_2d"]["occlusion"].value_counts()
        report = SequenceReport(
            sequence,
            read.problems,
            layers=list(entry.layers),
            steps={layer: step_of(read.frames[layer][0]) for layer in entry.layers if layer not in NOT_LABELS},
            ranges={layer: part for layer in entry.layers if (part := ranges[layer])},
            occlusions={part["values"] or "": part["counts"] for part in occlusions.to_pylist()},
            odd_values={layer: list(odd_values(layer, path)) for layer, path in found.labels.items()},
            files=files,
            frames=intervals["frames"].num_rows,
            people=intervals["persons"].num_rows,
            boxes=tables["boxes_2d"].num_rows,
            boxes_3d=tables["boxes_3d"].num_rows,
            visibility=intervals["sequence"]["visibility"][0].as_py(),
            unknown_labels=read.unknown,
            heading=read.heading,
            label_frames=labels,
            image_frames=images,
            shifts=read.shifts,
            stamps=stamps_of(tables["timestamps"]),
            cameras=cameras,
            disagreements=disagreements(tables),
            absent_partners=absent_partners(tables["interactions"], tables["boxes_2d"]),
            warnings=[
                *sequence_warnings(labels, images, read.heading, cameras),
                *beside_warnings(intervals["sightings"]),
                *box_warnings(tables["boxes_2d"]),
            ],
        )
        return ShardResult(report, entry, sketch_boxes(tables["boxes_2d"]))


@contextlib.contextmanager
def _one_heap() -> Iterator[None]:
    """Let Arrow and numpy share a heap inside a `with` block, so that each reuses memory that the other has freed."""
    before = pa.default_memory_pool()
    pa.set_memory_pool(pa.system_memory_pool())
    try:
        yield
    finally:
        pa.set_memory_pool(before)


def rebuild_shard(item: tuple[str, SequenceEntry], store: str, staging: str, rules: LoadRules) -> SequenceEntry:
    """Derive the intervals of one sequence from its annotation tables, and write them into the staging folder."""
    sequence, before = item
    tables = {layer: _loaded_table(Store(store), layer, sequence, before) for layer in ANNOTATIONS}
    kept = {path: digest for path, digest in before.tables.items() if path.startswith(PARTS[0])}
    entry = _write(Store(staging), sequence, {}, derive(sequence, tables, rules))
    return SequenceEntry(entry.layers, {**kept, **entry.tables})


def _loaded_table(store: Store, layer: str, sequence: str, entry: SequenceEntry) -> pa.Table:
    """Return the annotation table of a layer. Raise StoreError if the file of the table has changed since the load."""
    path = store.annotation_path(layer, sequence)
    table = store.annotation(layer, sequence)
    if file_hash(path) != entry.tables.get(path.relative_to(store.path).as_posix()):
        raise StoreError(f"{path} is not the file that was loaded: load the annotations again")
    return table


def _write(
    staging: Store, sequence: str, annotations: dict[str, pa.Table], intervals: dict[str, pa.Table]
) -> SequenceEntry:
    tables = {}
    for kept, path_of, write in (
        (annotations, staging.annotation_path, staging.write_annotation),
        (intervals, staging.interval_path, staging.write_interval),
    ):
        for name, table in kept.items():
            tables[path_of(name, sequence).relative_to(staging.path).as_posix()] = write(name, sequence, table)
    stage_scene(staging, sequence, intervals)
    return SequenceEntry(tuple(intervals["sequence"]["layers"][0].as_py()), tables)


# -- the store ---------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _staging(store: Store) -> Iterator[Store]:
    """Yield an empty staging folder, and delete it when the `with` block ends.

    The folder is not deleted if it then holds tables that must still be moved into the store. The caller must
    hold the writer's lock.
    """
    staging = Store(store.path / STAGING)
    try:
        _finish_moves(store)
        shutil.rmtree(staging.path, ignore_errors=True)
        staging.path.mkdir()
    except OSError as error:
        raise StoreError(f"cannot write to {store.path}: {error.strerror}; choose another --store") from None
    try:
        yield staging
    finally:
        if not _half_moved(store):
            shutil.rmtree(staging.path, ignore_errors=True)


def _finish(
    store: Store,
    staging: Store,
    image_root: str | None,
    rules: LoadRules,
    entries: dict[str, SequenceEntry],
    parts: Sequence[str],
) -> list[str]:
    """Build the graph, then move the staged folders named in `parts`, and the staged manifest, into the store.

    Return one line for each run that the graph leaves out.
    """
    manifest = Manifest(image_root and store.relative(image_root), rules, rules_hash(rules), entries, {})
    left_out = write_graph(store, partial(_build, store, staging, manifest))
    _move(store, staging, parts)
    return left_out


def _move(store: Store, staging: Store, parts: Sequence[str]) -> None:
    for part in parts:
        _swap(store.path / part, staging.path / part, staging.path / f"old_{part}")
    (staging.path / "store.json").replace(store.path / "store.json")


def _half_moved(store: Store) -> bool:
    """Return whether a load was killed between the deletion of the old manifest and the move of the new manifest."""
    return (store.path / STAGING / "store.json").exists() and not (store.path / "store.json").exists()


def _finish_moves(store: Store) -> None:
    """Do the work of `resume`. The caller must hold the writer's lock."""
    if _half_moved(store):
        staging = Store(store.path / STAGING)
        remove_graph(store.graph_path)
        _move(store, staging, [part for part in PARTS if (staging.path / part).exists()])


def _build(store: Store, staging: Store, manifest: Manifest) -> list[str]:
    """Build the graph with the scene and the runs' world models, stage the new manifest, and delete the old manifest.

    Return one line for each run that the graph leaves out.
    """
    with build_graph(store.graph_path) as graph:
        rows = build_scene(graph, staging, list(manifest.sequences))
        make_world_tables(graph)
        left_out = copy_all(graph, store, run_ids(store))
        staging.write_manifest(msgspec.structs.replace(manifest, graph=rows))
        # A store without a manifest is refused, so no reader uses a store with only some of its new tables.
        (store.path / "store.json").unlink(missing_ok=True)
    return left_out


def _swap(path: Path, new: Path, old: Path) -> None:
    """Rename `path` to `old` if `path` exists. Then rename `new` to `path`."""
    if path.exists():
        path.rename(old)
    new.rename(path)


# -- reports -----------------------------------------------------------------------------------------------------


def _reports(root: Root, results: dict[str, ShardResult]) -> list[SequenceReport]:
    reports = [result.report for _, result in sorted(results.items())]
    notes = list(root.notes)
    for (name, first), (other, second) in combinations(sorted(results.items()), 2):
        # Unrelated recordings share at most a few boxes. Recordings with fewer than 16 boxes are not compared.
        common, fewer = len(first.sketch & second.sketch), min(len(first.sketch), len(second.sketch))
        if common >= max(16, fewer / 4):
            notes.append(f"{name} and {other} have the same boxes: if they are one recording, delete the files of one")
    if root.problems or notes:
        reports.append(SequenceReport("", list(root.problems), warnings=notes))
    return reports


def _nothing(root: Root, reports: list[SequenceReport]) -> str:
    """Return the error message for a root if no sequence could be loaded. The message states the first problem."""
    first = next((problem for report in reports for problem in report.problems), None)
    why = f"; first: {first.file}: {first.reason}" if first else ""
    return f"{root.path}: no sequence could be loaded ({len(reports)} tried){why}"
