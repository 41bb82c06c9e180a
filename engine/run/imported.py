"""Predictions that were made elsewhere, taken into a store as a run of their own."""

from __future__ import annotations

import datetime
import hashlib
from pathlib import Path
from typing import Final

from jrdb_avr.engine.report.prediction_lines import LARGEST_FILE, parse_lines, read_regular
from jrdb_avr.engine.run.selection import QuestionSelection, matching
from jrdb_avr.queries.questions import read_questions
from jrdb_avr.queries.runs import RunManifest, questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.card import is_of_sample
from jrdb_avr.schema.errors import InputError, StoreError

IMPORTED: Final = "imported"
"""The method of such a run; of its model nothing is known."""


def import_predictions(store: Store | str | Path, path: str | Path, run_id: str | None = None) -> str:
    """Take a file of prediction lines into a store as a run, and return its id: that of the file's name without one.

    The run's questions are those that the file has lines of. Raises InputError for a file that cannot be
    read or names a question that the store lacks, StoreError where the run exists.
    """
    store, path = Store.of(store), Path(path)
    run_id = path.stem if run_id is None else run_id
    folder = store.run_path(run_id)
    if folder.exists():
        raise StoreError(f"run {run_id!r} exists: give the predictions another run id")
    data = read_regular(path, LARGEST_FILE)
    predictions = parse_lines(data, run_id, path)
    if not len(predictions):
        raise InputError(f"{path} holds no prediction", file=str(path))
    selection = QuestionSelection.of(predictions["question_id"].to_pylist())
    questions = matching(read_questions(store), selection)
    manifest = RunManifest(
        run_id=run_id,
        method=IMPORTED,
        model="",
        questions_sha256=questions_hash(store),
        question_ids=tuple(question.question_id for question in questions),
        synthetic=any(is_of_sample(question.sequence) for question in questions),
        settings={"from": path.name, "sha256": hashlib.sha256(data).hexdigest()},
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    )
    write_run_manifest(store, manifest)
    # Predictions come last: a run that has them is complete.
    store.write_run(run_id, "predictions", predictions.sort_by("question_id"))
    return run_id
