"""List, show and remove the runs of a store."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.engine.run.journal import journal_folder, journal_lock, segments
from jrdb_avr.engine.run.methods import WORLD_METHODS
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest, run_ids
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.errors import StoreError, did_you_mean
from jrdb_avr.schema.method import DIAGNOSTIC

_REASONS: Final = 3
"""Maximum number of reasons per status that `show_run` lists."""


_TRASH: Final = ".removed-"
"""Prefix of folders that are being deleted. If a deletion is killed, the next call of `remove_run` completes it."""


class _Line(msgspec.Struct):
    """The fields of a journal line that this module needs."""

    question_id: str
    prediction: dict[str, Any]


def list_runs(store: Store | str | Path) -> list[dict[str, Any]]:
    """List the runs of a store.

    Args:
        store: The store, or its folder.

    Returns:
        One row per run, sorted by run id. A row has the method, the model, the label, the state, the number of
        questions, the number of questions with each status, and the start time. The label is "synthetic" or empty. The
        state is "complete", "unfinished", "damaged", or "other questions". The state
        "other questions" means that the questions of the store have changed since the run. The row of a damaged run has
        no numbers.
    """
    store = Store.of(store)
    if not run_ids(store):
        store.manifest()  # Raises if the folder is not a store.
    return [_row(store, name) for name in run_ids(store)]


def _row(store: Store, run_id: str) -> dict[str, Any]:
    try:
        manifest = read_run_manifest(store, run_id)
        rows = _predictions(store, run_id)
    except StoreError:
        return {"run": run_id, "method": "", "model": "", "label": "", "state": "damaged", "n": None}
    counts = Counter(row["status"] for row in rows)
    return {
        "run": run_id,
        "method": manifest.method,
        "model": manifest.model,
        "label": ", ".join(["synthetic"] * manifest.synthetic + ["diagnostic"] * (manifest.method in DIAGNOSTIC)),
        "state": _state(store, manifest, len(rows)),
        "n": len(manifest.question_ids),
        **{status: counts[status] for status in ("answered", "invalid", "error")},
        "created": manifest.created,
    }


def _state(store: Store, manifest: RunManifest, played: int) -> str:
    path = store.question_path("questions")
    if path.exists() and questions_hash(store) != manifest.questions_sha256:
        return "other questions"
    # If a person stops early, the tables have only the finished questions.
    written = (store.run_path(manifest.run_id) / "predictions.parquet").exists()
    return "complete" if written and played == len(manifest.question_ids) else "unfinished"


def show_run(store: Store | str | Path, run_id: str) -> dict[str, Any]:
    """Describe a run.

    Args:
        store: The store, or its folder.
        run_id: The id of the run.

    Returns:
        A dict of plain values: the run's row of `list_runs`, its selection, settings and folder, and the most frequent
        reasons of its invalid predictions and of its errors.

    Raises:
        StoreError: If the run is missing or damaged.
    """
    store = Store.of(store)
    _require(store, run_id)
    manifest = read_run_manifest(store, run_id)
    reasons = Counter((row["status"], row["reason"]) for row in _predictions(store, run_id) if row["reason"])
    commonest = {
        status: [f"{times} x {reason}" for (key, reason), times in reasons.most_common() if key == status][:_REASONS]
        for status in ("invalid", "error")
    }
    return {
        **_row(store, run_id),
        "selection": manifest.selection,
        "settings": manifest.settings,
        **{f"commonest {status}": texts for status, texts in commonest.items() if texts},
        "folder": str(store.run_path(run_id)),
    }


def remove_run(store: Store | str | Path, run_id: str) -> None:
    """Delete the folder of a run, and delete its world model from the graph of the store.

    Args:
        store: The store, or its folder.
        run_id: The id of the run.

    Raises:
        StoreError: If the run is missing.
        LockedError: If the run is in progress, or if another process has the graph open.
    """
    from jrdb_avr.queries.beliefs.graph import open_graph
    from jrdb_avr.queries.beliefs.record import drop_world

    store = Store.of(store)
    for left in store.path.glob(f"{_TRASH}*"):
        shutil.rmtree(left, ignore_errors=True)
    _require(store, run_id)
    folder = store.run_path(run_id)
    journal = journal_folder(folder)
    with journal_lock(journal, "") if journal.exists() else contextlib.nullcontext():
        try:
            believes = read_run_manifest(store, run_id).method in WORLD_METHODS
        except StoreError:
            believes = True
        if believes and store.graph_path.exists():
            with open_graph(store.graph_path) as graph, graph.transaction():
                drop_world(graph, run_id)
        # The folder is moved first, because a partly deleted folder would still count as a run.
        try:
            trash = Path(tempfile.mkdtemp(prefix=_TRASH, dir=store.path))
            shutil.move(folder, trash)
        except OSError as error:
            raise StoreError(f"cannot remove {folder}: {error.strerror}") from None
        shutil.rmtree(trash, ignore_errors=True)


def _require(store: Store, run_id: str) -> None:
    ids = run_ids(store)
    if run_id not in ids:
        raise StoreError(f"{store.path} has no run {run_id[:100]!r}{did_you_mean(run_id, ids)}")


def _predictions(store: Store, run_id: str) -> list[dict[str, Any]]:
    """Return the status and the reason of each finished question.

    Both texts are read from the table `predictions`, or from the journal if this table has not been written yet.
    """
    folder = store.run_path(run_id)
    path = folder / "predictions.parquet"
    try:
        if path.exists():
            rows: list[dict[str, Any]] = read_table(path, ["status", "reason"]).to_pylist()
            return rows
        answers = {}
        for segment in segments(journal_folder(folder)):
            with segment.open("rb") as lines:
                # A line without an end is skipped, because another process may be writing it.
                for line in (msgspec.json.decode(text, type=_Line) for text in lines if text.endswith(b"\n")):
                    answers[line.question_id] = {
                        name: str(line.prediction.get(name, "")) for name in ("status", "reason")
                    }
        return list(answers.values())
    except (msgspec.DecodeError, UnicodeDecodeError, OSError, pa.ArrowException, KeyError) as error:
        raise StoreError(f"run {run_id}: its answers cannot be read ({str(error).splitlines()[0]})") from None
