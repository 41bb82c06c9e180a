"""Scores of whole runs. The runs come from a store or from bundles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.report.scored_runs import ScoredRun
from jrdb_avr.engine.report.scoring import find_questions, is_judged, score_predictions
from jrdb_avr.engine.report.truth import Truth, fit_schema
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest
from jrdb_avr.queries.store import Store, read_table, write_table
from jrdb_avr.schema.errors import InputError, StoreError, warn
from jrdb_avr.schema.tables import RUNS

_COLUMNS: Final = ("question_id", "status", "answer", "evidence_frame", *(f"evidence_{side}" for side in "xywh"))

SCORED: Final = pa.schema(map(RUNS["predictions"].field, _COLUMNS))
"""Schema of those columns of `predictions` that the scores depend on."""

_Source = TypeVar("_Source")


class Submission(NamedTuple):
    """A run to score: its manifest, and its predictions with the columns of `SCORED`."""

    manifest: RunManifest
    predictions: pa.Table


def read_submission(store: Store, run_id: str) -> Submission:
    """Read a run of a store.

    Args:
        store: The store that has the run and its questions.
        run_id: The id of the run.

    Returns:
        The run's manifest and predictions.

    Raises:
        StoreError: If the run is missing or unfinished, or if the questions of the store have changed since the run.
    """
    manifest = read_run_manifest(store, run_id)
    if manifest.questions_sha256 != questions_hash(store):
        raise StoreError(f"run {run_id} belongs to another questions file than this store's: score its bundle (submit)")
    path = predictions_path(store, run_id)
    return Submission(manifest, fit_schema(read_table(path, _COLUMNS), SCORED, path, "evaluate"))


def predictions_path(store: Store, run_id: str) -> Path:
    """Return the path of a run's predictions.

    Args:
        store: The store of the run.
        run_id: The id of the run.

    Returns:
        The path of a Parquet file that exists.

    Raises:
        StoreError: If the run is unfinished, so that the file does not exist.
    """
    path = store.run_path(run_id) / "predictions.parquet"
    if not path.exists():
        raise StoreError(f"run {run_id} has no predictions yet: continue it with --resume, or score it by its name")
    return path


def score_run(truth: Truth, submission: Submission, iou: float) -> ScoredRun:
    """Score one run.

    Args:
        truth: The true answers and evidence of all questions of the store, in the order of `sort_by_sequence`.
        submission: The run.
        iou: Minimum IoU of the evidence box and the target's box, in (0, 1]. Evidence with a smaller IoU is wrong.

    Returns:
        The run with its scores. Its questions are those with a prediction, in the order of `truth`.

    Raises:
        StoreError: If a prediction is not about a question of the run, or if the store lacks a question of the run, or
            if no question has a prediction.
        InputError: If `iou` is outside (0, 1].
    """
    manifest, predictions = submission
    answers = dict(zip(predictions["question_id"].to_pylist(), predictions["answer"].to_pylist(), strict=True))
    played = [name for name in manifest.question_ids if name in answers]
    if manifest.question_ids and not played:
        raise StoreError(f"run {manifest.run_id} has no prediction of its questions: continue it with --resume")
    rows = np.sort(find_questions(truth.ids, manifest.run_id, played))
    ids = truth.ids.take(pa.array(rows)).to_pylist()
    scores = score_predictions(truth, manifest.run_id, ids, predictions, iou)
    errors = len(rows) - int(np.count_nonzero(is_judged(predictions["status"])))
    return ScoredRun(manifest, rows, scores, errors, [answers.get(name) for name in ids])


def score_runs(
    truth: Truth,
    sources: Sequence[_Source],
    read: Callable[[_Source], Submission],
    iou: float,
    strict: bool,
) -> list[tuple[_Source, ScoredRun]]:
    """Score several runs.

    Args:
        truth: The true answers and evidence of all questions of the store, in the order of `sort_by_sequence`.
        sources: Run ids, or folders of bundles.
        read: Function that is called with each source and returns the run of the source.
        iou: Minimum IoU of the evidence box and the target's box, in (0, 1]. Evidence with a smaller IoU is wrong.
        strict: Whether a run that cannot be scored is an error. If not, it is left out with an AvrWarning.

    Returns:
        Each source with its scored run.

    Raises:
        StoreError: If `strict`, and the predictions of a run do not match its questions or the questions of the store.
        InputError: If `strict`, and a source is broken.
    """
    scored = []
    for source in sources:
        try:
            scored.append((source, score_run(truth, read(source), iou)))
        except (StoreError, InputError) as error:
            if strict:
                raise
            warn(f"left out: {error}")
    return scored


def write_scores(store: Store, run: ScoredRun, iou: float) -> None:
    """Write `scores.parquet` of a run, with the IoU threshold in its metadata.

    Args:
        store: The store of the run.
        run: The scored run.
        iou: Minimum IoU of the evidence box and the target's box. Evidence with a smaller IoU is wrong.
    """
    path = store.run_path(run.manifest.run_id) / "scores.parquet"
    write_table(path, run.table, RUNS["scores"], {"evidence_iou": f"{iou:g}"})
