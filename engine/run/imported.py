"""Predictions that were made elsewhere, taken into a store as a run of their own."""

from __future__ import annotations

import datetime
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.report.prediction_lines import LARGEST_FILE, parse_lines, read_regular
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.run import has_manifest
from jrdb_avr.engine.run.selection import matching
from jrdb_avr.queries.questions import QuestionRow, read_question_rows
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.card import is_of_sample
from jrdb_avr.schema.errors import InputError, StoreError

IMPORTED: Final = "imported"
"""The method of such a run; of its model nothing is known."""


def import_predictions(store: Store | str | Path, path: str | Path, run_id: str | None = None) -> str:
    """Take a file of prediction lines into a store as a run, and return its id: that of the file's name without one.

    The run's questions are those that the file has lines of. The same file is taken in again, which finishes what was
    killed. Raises InputError for a file that cannot be read or names a question that the store lacks, StoreError where
    the run is of other predictions.
    """
    store, path = Store.of(store), Path(path)
    run_id = path.stem if run_id is None else run_id
    data = read_regular(path, LARGEST_FILE)
    settings = {"from": path.name, "sha256": hashlib.sha256(data).hexdigest()}
    begun = _has_begun(store, run_id, settings)
    predictions = parse_lines(data, run_id, path)
    if not len(predictions):
        raise InputError(f"{path} holds no prediction", file=str(path))
    selection = QuestionSelection.of(predictions["question_id"].to_pylist())
    questions = matching(read_question_rows(store), selection)
    manifest = RunManifest(
        run_id=run_id,
        method=IMPORTED,
        model="",
        questions_sha256=questions_hash(store),
        question_ids=tuple(question.question_id for question in questions),
        synthetic=any(is_of_sample(question.sequence) for question in questions),
        settings=settings,
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    )
    if not begun:
        write_run_manifest(store, manifest)
    # Predictions come last: a run that has them is complete.
    store.write_run(run_id, "predictions", _in_order(predictions, questions))
    return run_id


def _in_order(predictions: pa.Table, questions: Sequence[QuestionRow]) -> pa.Table:
    """The predictions in the order of the tables of runs."""
    ordered = sorted((question.sequence, question.question_id) for question in questions)
    ids = predictions["question_id"].combine_chunks()
    return predictions.take(pc.index_in(pa.array([name for _, name in ordered], pa.string()), value_set=ids))


def _has_begun(store: Store, run_id: str, settings: dict[str, str]) -> bool:
    """Whether the same predictions were taken in before, in full or in part. Raises StoreError for a run of others."""
    if has_manifest(store, run_id):
        known = read_run_manifest(store, run_id)
        if (known.method, known.settings, known.questions_sha256) == (IMPORTED, settings, questions_hash(store)):
            return True
    elif not any(not path.name.startswith(".") for path in store.run_path(run_id).glob("*")):
        # A killed import may have left a hidden file.
        return False
    raise StoreError(f"run {run_id!r} exists: give the predictions another run id")
