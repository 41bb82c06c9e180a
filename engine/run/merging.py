"""Join the shards of a run into one run. Each shard was answered by `evaluate --shard`, on any machine."""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.engine.run.journal import Finished, world_rows
from jrdb_avr.engine.run.methods import WORLD_METHODS
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.run import Run, add_world_counts, find_difference
from jrdb_avr.engine.run.selection import draw_questions, matching
from jrdb_avr.queries.beliefs.graph import open_graph
from jrdb_avr.queries.beliefs.record import merge_world
from jrdb_avr.queries.files import write_atomic
from jrdb_avr.queries.opaque import stored_ids
from jrdb_avr.queries.questions import read_question_rows
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError

_KEYS: Final = ("run", "id", "episode", "source", "target", "look")
"""Fields of a fact (`schema.beliefs.Fact`) that hold the run id, or a text that begins with the run id."""
_id: Final = attrgetter("question_id")


def merge_runs(store: Store | str | Path, run_ids: Sequence[str], run_id: str) -> pa.Table:
    """Join all shards of a run in one new run. The shards remain in the store.

    Args:
        store: The store, or its folder. The shards are runs of this store, or of a public copy of it.
        run_ids: The run ids of all shards.
        run_id: The id of the new run.

    Returns:
        The table `predictions` of the new run.

    Raises:
        StoreError: If a shard is missing or unfinished, if shards differ in selection, method, model or settings, if
            the questions of all shards together are not exactly the selected questions, or if the new run exists.
        LockedError: If another process uses a shard, or uses the graph of the store.
    """
    store = Store.of(store)
    names = list(dict.fromkeys(run_ids))
    manifests = [read_run_manifest(store, name) for name in names]
    selection = _check_shards(store, manifests)
    if store.run_path(run_id).exists():
        # The answers of the existing run may come from another model, even if all settings are equal.
        raise StoreError(f"run {run_id!r} exists: give another --run-id, or delete it by 'runs remove'")
    with contextlib.ExitStack() as stack:
        answers = [stack.enter_context(Run(store, name)).finished for name in names]
        for manifest, finished in zip(manifests, answers, strict=True):
            if missing := set(manifest.question_ids) - set(finished):
                raise StoreError(f"run {manifest.run_id!r} lacks {len(missing)} answers: finish it with --resume")
        first, synthetic = manifests[0], any(manifest.synthetic for manifest in manifests)
        # The graph is opened before the run is made. If another process uses the graph, no unfinished run is left.
        has_world = first.method in WORLD_METHODS and store.graph_path.exists()
        graph = stack.enter_context(open_graph(store.graph_path)) if has_world else None
        run = stack.enter_context(Run(store, run_id))
        opaque = stored_ids(store)
        ids = [opaque.get(name, name) for manifest in manifests for name in manifest.question_ids]
        run.start(first.method, first.model, ids, first.settings, synthetic, selection)
        for manifest, finished in zip(manifests, answers, strict=True):
            add_world_counts(store, run_id, manifest.world)
            for name in manifest.question_ids:
                run.append(_rename_world(finished[name], manifest.run_id, run_id))
        _join_calls([store.run_path(name) for name in names], store.run_path(run_id))
        if graph is not None:
            merge_world(graph, run_id, world_rows(run_id, run.finished))
        return run.finish()


def _check_shards(store: Store, manifests: Sequence[RunManifest]) -> dict[str, Any]:
    """Return the selection of the whole run. Raise StoreError if the runs are not exactly the shards of one run."""
    first, shards = manifests[0], [_shard(manifest) for manifest in manifests]
    whole, (_, count) = shards[0]
    rows, opaque = read_question_rows(store), stored_ids(store)
    if public := first.questions_sha256 == questions_hash(store, opaque):
        ids_of = dict(zip(opaque.values(), opaque, strict=True))
        rows = sorted((dataclasses.replace(row, question_id=ids_of[row.question_id]) for row in rows), key=_id)
    for manifest, (selection, (_, shard_count)) in zip(manifests, shards, strict=True):
        if manifest.questions_sha256 != questions_hash(store, opaque if public else None):
            raise StoreError(f"run {manifest.run_id!r} has other questions than the store has now")
        sizes = "selection" if selection != whole else "number of shards" if shard_count != count else ""
        if what := find_difference(first, manifest) or sizes:
            hint = ": copy opaque.key of one store to each store before the shards run" if what == "opaque.key" else ""
            raise StoreError(f"runs {first.run_id!r} and {manifest.run_id!r} differ in the {what}{hint}")
    numbers = sorted(shard for _, (shard, _) in shards)
    if len(numbers) != count or numbers != list(range(1, count + 1)):
        raise StoreError(f"the runs are the shards {', '.join(map(str, numbers))} of {count}: give each shard once")
    ids = sorted(name for manifest in manifests for name in manifest.question_ids)
    if ids != sorted(map(_id, draw_questions(matching(rows, whole), whole))):
        raise StoreError("the shards together have other questions than their selection has on this store")
    return whole.record()


def _shard(manifest: RunManifest) -> tuple[QuestionSelection, tuple[int, int]]:
    """Return the selection of the whole run, and the pair (I, N) of a run that is shard I of N. I starts at 1."""
    try:
        selection = msgspec.convert(manifest.selection, QuestionSelection)
    except msgspec.ValidationError as error:
        raise StoreError(f"the selection in run.json of run {manifest.run_id!r} is invalid: {error}") from None
    if selection.shard is None:
        raise StoreError(f"run {manifest.run_id!r} is not a shard: evaluate with --shard I/N")
    return dataclasses.replace(selection, shard=None), selection.shard


def _rename_world(entry: Finished, old: str, new: str) -> Finished:
    """Return a copy of an entry with the run id `new` instead of `old` in all facts."""
    world = [{**row, "fact": _rename_fact(row["fact"], old, new)} for row in entry.world]
    return msgspec.structs.replace(entry, world=world)


def _rename_fact(fact: str, old: str, new: str) -> str:
    def rename(value: Any, field: str = "") -> Any:
        if isinstance(value, dict):
            return {name: rename(item, name) for name, item in value.items()}
        if isinstance(value, list):
            return [rename(item, field) for item in value]
        is_key = field in _KEYS and isinstance(value, str) and (value == old or value.startswith(f"{old}/"))
        return new + value.removeprefix(old) if is_key else value

    return msgspec.json.encode(rename(msgspec.json.decode(fact))).decode() if fact else fact


def _join_calls(folders: Sequence[Path], folder: Path) -> None:
    """Write the stored model calls of all shards to one file, for a new run that may be resumed.

    A resumed run does not repeat the calls in this file.
    """

    def write(path: Path) -> None:
        with path.open("wb") as joined:
            for source in (source_folder / "calls.jsonl" for source_folder in folders):
                if source.exists():
                    with source.open("rb") as lines:
                        shutil.copyfileobj(lines, joined)

    write_atomic(folder / "calls.jsonl", write)
