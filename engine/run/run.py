"""Store a run on disk: its manifest, its journal, and its tables.

runs/<run_id>/run.json                    the manifest, written first: questions, method, model and settings
runs/<run_id>/journal/<sequence>.jsonl    one line per finished question, written when the question finishes
runs/<run_id>/predictions.parquet, steps.parquet, world.parquet   written from the journal when the run ends or stops
"""

from __future__ import annotations

import datetime
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import msgspec
import pyarrow as pa

from jrdb_avr.engine.report.bundle import check_size
from jrdb_avr.engine.run.journal import Finished, Journal, journal_folder, with_id, write_tables
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.selection import matching, select_questions
from jrdb_avr.queries.opaque import opaque_names, stored_ids
from jrdb_avr.queries.questions import QuestionRow, read_question_rows, sequences_of_questions
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError, StoreError

_ACCESS: Final = (
    *("base_url", "timeout_s", "retries", "token_parameter", "headers", "api_key_env"),
    *("rpm", "tpm", "price", "max_cost"),
)
"""Settings of an endpoint that do not influence replies, such as its address."""

_MAY_BE_EMPTY: Final = ("server version",)
"""Settings that are empty if the server was too busy to report them. An empty value counts as equal to any other."""


class Run(Journal):
    """A run in progress. `start` writes the manifest, `append` writes to the journal, and `finish` writes the tables.

    After an appended entry is on disk, each function in `listeners` is called with this entry.

        with Run(store, "mine") as run:
            run.start("method", "model", ids, {}, False, {})
            run.append(entry)
            run.finish()
    """

    def __init__(self, store: Store, run_id: str) -> None:
        """Open the run and take its lock.

        Args:
            store: The store of the run.
            run_id: The id of the run.

        Raises:
            LockedError: If another process holds the lock.
            StoreError: If the journal is damaged, if it cannot be written, or if it has answers but no manifest.
        """
        folder = store.run_path(run_id)
        super().__init__(journal_folder(folder), sequences_of_questions(store), stored_ids(store))
        self.store, self.run_id = store, run_id
        self._writing = threading.Lock()
        self._over = False
        self.listeners: list[Callable[[Finished], None]] = []
        if self.finished and not has_manifest(store, run_id):
            self.close()
            # Without a manifest, the answers may come from another model.
            raise StoreError(f"{folder} has answers but no run.json: delete the folder, or give another --run-id")

    def start(
        self,
        method: str,
        model: str,
        question_ids: Iterable[str],
        settings: dict[str, Any],
        synthetic: bool,
        selection: dict[str, Any],
    ) -> RunManifest:
        """Write the manifest of a new run, or compare it with the manifest of the run that is resumed.

        A resumed run may have more questions than before. The manifest on disk then gets the new questions.

        Args:
            method: The name of the method.
            model: The id of the model.
            question_ids: The ids of the questions.
            settings: All other settings that influence the answers, as plain JSON.
            synthetic: Whether the run uses the simulated model or the sample world.
            selection: The result of `QuestionSelection.record()` for these questions.

        Returns:
            The manifest.

        Raises:
            InputError: If the name of the method or model, or the settings are too large or cannot be written as JSON.
            StoreError: If the run on disk has another method, model or setting that influences answers.
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
        try:
            # A custom method's settings may have 20 levels. Two are around them.
            check_size(manifest, 22)
        except (ValueError, TypeError) as error:
            raise InputError(f"run {self.run_id!r} cannot be stored: {error}; change it", field="method") from None
        check_manifest(self.store, manifest)
        self.callback(self.finish_stopped)
        return manifest

    def finish_stopped(self) -> None:
        """Write the tables of the finished questions, if there are any, unless `finish` has been called."""
        if not self._over:
            with self._writing:
                # An interrupt may have come after an entry was on disk and before it was in `finished`.
                self.finished = self._replay()
            if self.finished:
                self.finish()

    def append(self, entry: Finished) -> None:
        """Append the entry of a finished question to the journal, and return when it is on disk.

        Args:
            entry: The entry. If its question has an opaque id, the journal gets the id in the store.

        Raises:
            StoreError: If writing fails, or if `finish` has already been called. For example, a player's last move may
                arrive while the run ends.
        """
        if stored := self._aliases.get(entry.question_id):
            entry = with_id(entry, stored)
        with self._writing:
            if self._over:
                raise StoreError(f"run {self.run_id!r} has ended: play this question again with --resume")
            super().append(entry)
        for listen in self.listeners:
            listen(entry)

    def finish(self) -> pa.Table:
        """Write the tables of all finished questions of the run, and return the table `predictions`."""
        with self._writing:
            self._over = True
        ids = read_run_manifest(self.store, self.run_id).question_ids
        return write_tables(self.store, self.run_id, self.finished.of(ids))


def write_partial(store: Store, run_id: str) -> None:
    """Write the tables of the finished questions if a run has none, because its process was killed.

    Args:
        store: The store of the run.
        run_id: The id of the run.

    Raises:
        LockedError: If the run is in progress.
    """
    if has_manifest(store, run_id) and not (store.run_path(run_id) / "predictions.parquet").exists():
        with Run(store, run_id) as run:
            run.finish_stopped()


def check_manifest(store: Store, manifest: RunManifest) -> None:
    """Write the manifest of a new run, or compare it with the manifest of the run on disk.

    If the new manifest has more questions, they are added to the manifest on disk. The tables `predictions` and
    `scores` are then deleted, so that the run counts as unfinished.

    Args:
        store: The store of the run.
        manifest: The manifest of the new or resumed run.

    Raises:
        StoreError: If the manifests differ in a setting that influences predictions. The message names the setting.
    """
    if not has_manifest(store, manifest.run_id):
        write_run_manifest(store, manifest)
        return
    before = read_run_manifest(store, manifest.run_id)
    if what := find_difference(before, manifest):
        raise StoreError(
            f"run {manifest.run_id!r} differs in the {what}: resume it as it was, or give another --run-id"
        )
    if set(before.question_ids) != set(manifest.question_ids):
        # A run without the table `predictions` counts as unfinished. Its answers remain in the journal.
        for name in ("scores", "predictions"):
            (store.run_path(manifest.run_id) / f"{name}.parquet").unlink(missing_ok=True)
        grown = {"question_ids": manifest.question_ids, "selection": manifest.selection}
        write_run_manifest(store, msgspec.structs.replace(before, **grown))


def find_difference(first: RunManifest, second: RunManifest) -> str:
    """Return the name of a setting that influences predictions and differs between two runs.

    Return "" if no setting differs.
    """
    before, now = _shaping(first), _shaping(second)
    for what in dict.fromkeys(["method", "model", *sorted(before.keys() | now.keys())]):
        pair = before.get(what), now.get(what)
        if pair[0] != pair[1] and not (what in _MAY_BE_EMPTY and "" in pair):
            return what
    return ""


def key_fingerprint(store: Store) -> str:
    """Return a text that identifies the store's key without revealing the key.

    If the store has no key, write a new key. Raise StoreError if the file with the key is damaged, or if this file
    cannot be read or written.
    """
    # The opaque name of "" depends only on the key. No run uses this name, because no sequence has an empty name.
    return opaque_names(store, [""])[""].removeprefix("sequence-")


def add_world_counts(store: Store, run_id: str, counts: Mapping[str, int]) -> None:
    """Add counts of a world model's statements to the counts in the manifest of a run.

    Args:
        store: The store of the run.
        run_id: The id of the run.
        counts: The number of statements of each kind that were executed since the world model was opened. The keys are
            the kinds.
    """
    manifest = read_run_manifest(store, run_id)
    total = {kind: manifest.world.get(kind, 0) + count for kind, count in counts.items()}
    write_run_manifest(store, msgspec.structs.replace(manifest, world=total))


def has_manifest(store: Store, run_id: str) -> bool:
    """Return whether a run has a manifest, which means that the run has begun."""
    return (store.run_path(run_id) / "run.json").exists()


def _shaping(manifest: RunManifest) -> dict[str, Any]:
    """Return the settings that must be equal in a resumed run and in the run on disk.

    The keys are the names that error messages use for the settings.
    """
    settings = dict(manifest.settings)
    endpoint: Mapping[str, Any] = settings.pop("endpoint", {})
    # The results of the preflight may differ, because a resumed run may use another server.
    settings.pop("preflight", None)
    settings.pop("unreadable_questions", None)
    return {
        "method": manifest.method,
        "model": manifest.model,
        "method settings": settings.pop("method", {}),
        "opaque.key": settings.pop("opaque", ""),
        "request settings": {name: value for name, value in endpoint.items() if name not in _ACCESS},
        **{name.replace("_", " "): value for name, value in settings.items()},
    }


def run_questions(
    store: Store, run_id: str, selection: QuestionSelection, resume: bool, image_root: str | None
) -> tuple[list[QuestionRow], dict[str, Any]]:
    """Select the questions of a new or a resumed run.

    Args:
        store: The store of the run.
        run_id: The id of the run.
        selection: The selection. If a run is resumed with the default selection, the run keeps its questions.
        resume: Whether to continue the run if it exists.
        image_root: The folder that has one folder of panoramas per sequence, or None without panoramas.

    Returns:
        The questions, and the selection as plain JSON (`QuestionSelection.record`).

    Raises:
        InputError: If the selection names a question, family, template or sequence that the store lacks.
        StoreError: If no question is selected, if the run exists and `resume` is false, if the questions of the store
            have changed since the run, or if the selection leaves out a question of the run.
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
    chosen = select_questions(questions, selection, image_root)
    if left_out := set(manifest.question_ids) - {question.question_id for question in chosen}:
        raise StoreError(
            f"run {run_id!r} has {len(left_out)} questions that this selection leaves out: select more, select nothing "
            "to finish the run as it is, or give another --run-id"
        )
    return chosen, record
