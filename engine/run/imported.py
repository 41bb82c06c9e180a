"""Import predictions that another program made. The imported predictions become a run of a store."""

from __future__ import annotations

import datetime
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.report.prediction_lines import LARGEST_FILE, parse_lines
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.run import has_manifest
from jrdb_avr.engine.run.selection import matching
from jrdb_avr.loaders.inputs import read_input, to_utf8
from jrdb_avr.queries.opaque import stored_ids
from jrdb_avr.queries.questions import QuestionRow, read_question_rows
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.card import is_of_sample
from jrdb_avr.schema.errors import InputError, StoreError

IMPORTED: Final = "imported"
"""Name of the method in the manifest of an imported run. The manifest names no model."""


def import_predictions(store: Store | str | Path, path: str | Path, run_id: str | None = None) -> str:
    """Import a file of predictions as a run.

    The file has one prediction per line, as JSON (`report.prediction_lines`). The questions of the run are the
    questions that the lines name, by their ids in the store or by opaque ids. If an import was killed, another import
    of the same file finishes the run.

    Args:
        store: The store, or its folder.
        path: The file.
        run_id: The id of the run. Default: the name of the file without its ending.

    Returns:
        The id of the run.

    Raises:
        InputError: If the file cannot be read, or if it names a question that the store lacks.
        StoreError: If a run with this id exists and has other predictions.
    """
    store, path = Store.of(store), Path(path)
    run_id = path.stem if run_id is None else run_id
    data = to_utf8(read_input(path, LARGEST_FILE), path)
    settings = {"from": path.name, "sha256": hashlib.sha256(data).hexdigest()}
    begun = _has_begun(store, run_id, settings)
    predictions = parse_lines(data, run_id, path, stored_ids(store))
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
    # The predictions are written last, because a run that has predictions counts as complete.
    store.write_run(run_id, "predictions", _in_order(predictions, questions))
    return run_id


def _in_order(predictions: pa.Table, questions: Sequence[QuestionRow]) -> pa.Table:
    """Sort predictions by sequence and question id. All tables of runs are sorted in this way."""
    ordered = sorted((question.sequence, question.question_id) for question in questions)
    ids = predictions["question_id"].combine_chunks()
    return predictions.take(pc.index_in(pa.array([name for _, name in ordered], pa.string()), value_set=ids))


def _has_begun(store: Store, run_id: str, settings: dict[str, str]) -> bool:
    """Return whether an earlier import of the same file has begun the run.

    Raise StoreError if the run exists, but an import of this file has not begun it.
    """
    if has_manifest(store, run_id):
        manifest = read_run_manifest(store, run_id)
        begun = (manifest.method, manifest.settings, manifest.questions_sha256)
        if begun == (IMPORTED, settings, questions_hash(store)):
            return True
    elif not any(not path.name.startswith(".") for path in store.run_path(run_id).glob("*")):
        # The folder is missing or has only hidden files. A killed import may have left hidden files.
        return False
    raise StoreError(f"run {run_id!r} exists: give the predictions another run id")
