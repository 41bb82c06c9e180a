"""A run on disk: its manifest, its journal, and the tables at its end.

runs/<run_id>/run.json                    the manifest: questions, method, model and settings; written first
runs/<run_id>/journal/<sequence>.jsonl    one line per finished question, synced as it finishes
runs/<run_id>/predictions.parquet, steps.parquet, world.parquet   written from the journal at the end
"""

from __future__ import annotations

import datetime
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.engine.run.journal import Finished, Journal, journal_folder, write_tables
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.selection import matching, select_questions
from jrdb_avr.queries.questions import QuestionRow, read_question_rows, sequences_of_questions
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError

_ACCESS: Final = (
    *("base_url", "timeout_s", "retries", "token_parameter", "headers", "api_key_env"),
    *("rpm", "tpm", "price", "max_cost"),
)
"""Settings of an endpoint that do not shape replies: a server may have moved, or need more time."""

_MAY_BE_EMPTY: Final = ("server version",)
"""Settings that are empty where the server did not report them: too busy to answer once, it is no other server."""


class Run(Journal):
    """A run that answers are added to: `start` writes its manifest, `append` its journal, `finish` its tables.

    listeners: called with each entry once it is on disk.

        with Run(store, "mine") as run:
            run.start("method", "model", ids, {}, False, {})
            run.append(entry)
            run.finish()
    """

    def __init__(self, store: Store, run_id: str) -> None:
        """Take the run's lock. Raises LockedError, or StoreError for a run that is damaged."""
        folder = store.run_path(run_id)
        if (folder / "journal.jsonl").exists():
            raise StoreError(f"{folder} was begun by an older version: delete it, or give another --run-id")
        super().__init__(journal_folder(folder), sequences_of_questions(store))
        self.store, self.run_id = store, run_id
        self._writing = threading.Lock()
        self._over = False
        self.listeners: list[Callable[[Finished], None]] = []
        if self.finished and not has_manifest(store, run_id):
            self.close()
            # They may be another model's.
            raise StoreError(
                f"{store.run_path(run_id)} holds answers and no run.json: delete it, or give another --run-id"
            )

    def start(
        self,
        method: str,
        model: str,
        question_ids: Iterable[str],
        settings: dict[str, Any],
        synthetic: bool,
        selection: dict[str, Any],
    ) -> RunManifest:
        """Write the manifest, or check that it is that of the run, which more questions enlarge.

        Raises StoreError for another one. `selection`: `QuestionSelection.record()` of the questions.
        """
        manifest = RunManifest(
            run_id=self.run_id,
            method=method,
            model=model,
            questions_sha256=questions_hash(self.store),
            question_ids=tuple(question_ids),
            synthetic=synthetic,
            settings=settings,
            selection=selection,
            created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        )
        check_manifest(self.store, manifest)
        return manifest

    def append(self, entry: Finished) -> None:
        """Add a finished question; returns when it is on disk. Raises StoreError also after `finish`: a player's thread
        may still be at work."""
        with self._writing:
            if self._over:
                raise StoreError(f"run {self.run_id!r} has ended: play this question again with --resume")
            super().append(entry)
        for listen in self.listeners:
            listen(entry)

    def finish(self) -> pa.Table:
        """Write the tables of the run's questions that are finished; returns the predictions."""
        with self._writing:
            self._over = True
        ids = read_run_manifest(self.store, self.run_id).question_ids
        return write_tables(self.store, self.run_id, self.finished.of(ids))


def check_manifest(store: Store, manifest: RunManifest) -> None:
    """Write a new run's manifest, or compare it with the one that the run has; more questions enlarge the run.

    Raises StoreError for a difference in anything that shapes predictions, and names it.
    """
    if not has_manifest(store, manifest.run_id):
        write_run_manifest(store, manifest)
        return
    known = read_run_manifest(store, manifest.run_id)
    before, now = _shaping(known), _shaping(manifest)
    for what in sorted(before.keys() | now.keys()):
        pair = before.get(what), now.get(what)
        if pair[0] != pair[1] and not (what in _MAY_BE_EMPTY and "" in pair):
            raise StoreError(
                f"run {manifest.run_id!r} had another {what}: resume it as it was, or give another --run-id"
            )
    if set(known.question_ids) != set(manifest.question_ids):
        # Without predictions it is unfinished, as it now is; the journal keeps its answers.
        for name in ("scores", "predictions"):
            (store.run_path(manifest.run_id) / f"{name}.parquet").unlink(missing_ok=True)
        grown = {"question_ids": manifest.question_ids, "selection": manifest.selection}
        write_run_manifest(store, msgspec.structs.replace(known, **grown))


def add_world_counts(store: Store, run_id: str, counts: Mapping[str, int]) -> None:
    """Add how often this session read and wrote the world model to the counts in the run's manifest."""
    manifest = read_run_manifest(store, run_id)
    total = {kind: manifest.world.get(kind, 0) + number for kind, number in counts.items()}
    write_run_manifest(store, msgspec.structs.replace(manifest, world=total))


def has_manifest(store: Store, run_id: str) -> bool:
    """Whether a run has begun."""
    return (store.run_path(run_id) / "run.json").exists()


def _shaping(manifest: RunManifest) -> dict[str, Any]:
    """The settings that must be equal where a run is resumed, by their names in the error message."""
    settings = dict(manifest.settings)
    endpoint: Mapping[str, Any] = settings.pop("endpoint", {})
    # What the checks found is known of the server that the run began with.
    settings.pop("preflight", None)
    return {
        "method": manifest.method,
        "model": manifest.model,
        "settings": settings.pop("method", {}),
        "request settings": {name: value for name, value in endpoint.items() if name not in _ACCESS},
        **{name.replace("_", " "): value for name, value in settings.items()},
    }


def run_questions(
    store: Store, run_id: str, selection: QuestionSelection, resume: bool, image_root: str | None
) -> tuple[list[QuestionRow], dict[str, Any]]:
    """The questions of a run and the record of their selection: as selected, or as of the run that is resumed.

    Raises StoreError where the run exists and is not to be resumed, or has questions that the selection leaves out.
    """
    questions = read_question_rows(store)
    exists, record = has_manifest(store, run_id), selection.record()
    if not exists:
        return select_questions(questions, selection, image_root), record
    if not resume:
        raise StoreError(f"run {run_id!r} exists: add --resume to finish or enlarge it, or give another --run-id")
    manifest = read_run_manifest(store, run_id)
    if manifest.questions_sha256 != questions_hash(store):
        raise StoreError(f"run {run_id!r} has other questions than the store has now: give another --run-id")
    if not record:
        return matching(questions, QuestionSelection(questions=manifest.question_ids)), manifest.selection
    found = select_questions(questions, selection, image_root)
    if left_out := set(manifest.question_ids) - {question.question_id for question in found}:
        raise StoreError(
            f"run {run_id!r} has {len(left_out)} questions that this selection leaves out: choose more, leave the "
            "selection out to finish it as it is, or give another --run-id"
        )
    return found, record
