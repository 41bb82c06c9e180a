"""Scores of whole runs: their predictions are streamed past the answers, a few sequences at a time.

Evidence is read once for all runs. Memory holds the boxes of one group of sequences, a batch of each run's predictions
and, of every prediction, its scores: twelve bytes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jrdb_avr.engine.report.answer_key import AnswerKey
from jrdb_avr.engine.report.scored_runs import SCORES, ScoredRun
from jrdb_avr.engine.report.scoring import (
    Truth,
    is_judged,
    question_rows,
    row_numbers,
    score_predictions,
    stray_prediction,
)
from jrdb_avr.queries.questions import fitted
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest
from jrdb_avr.queries.store import Store, read_table, write_table
from jrdb_avr.schema.errors import InputError, StoreError
from jrdb_avr.schema.tables import RUNS

_RUNS_AT_ONCE: Final = 64
"""Runs that are scored while the evidence is read once; each has a file open."""

_BATCH: Final = 1 << 12
"""Predictions of a run in memory."""

_COLUMNS: Final = ("question_id", "status", "answer", "evidence_frame", *(f"evidence_{side}" for side in "xywh"))
"""The columns of `predictions` that are scored."""

_Run = TypeVar("_Run")

SCORED: Final = pa.schema(map(RUNS["predictions"].field, _COLUMNS))


class Submission(NamedTuple):
    """A run to be scored: its manifest, its predictions in parts, and its answers by question when they are wanted.

    The predictions are in the order of `queries.questions.in_order`.
    """

    manifest: RunManifest
    predictions: Iterator[pa.Table]
    answers: Callable[[], pa.Table]


def submission(store: Store, run_id: str) -> Submission:
    """A run of a store. Raises StoreError where it is missing, unfinished, or of other questions than the store's."""
    manifest = read_run_manifest(store, run_id)
    if manifest.questions_sha256 != questions_hash(store):
        raise StoreError(f"run {run_id} is of another questions file than this store's: score it in its own store")
    path = predictions_path(store, run_id)
    return Submission(manifest, _batches(path), lambda: read_table(path, ["question_id", "answer"]))


def predictions_path(store: Store, run_id: str) -> Path:
    """The file of a run's predictions. Raises StoreError where the run has none yet."""
    path = store.run_path(run_id) / "predictions.parquet"
    if not path.exists():
        raise StoreError(f"run {run_id} has no predictions yet: evaluate it to the end (the same call with --resume)")
    return path


def _batches(path: Path) -> Iterator[pa.Table]:
    """The columns of predictions that are scored, a batch at a time. Raises StoreError for an unfit file."""
    # What it lacks, and that it cannot be read, is said there.
    read_table(path, [])
    try:
        with pq.ParquetFile(path) as file:
            names = [name for name in _COLUMNS if name in file.schema_arrow.names]
            for batch in file.iter_batches(_BATCH, columns=names):
                yield fitted(pa.table(batch), SCORED, path, "evaluate")
    except (OSError, pa.ArrowException) as error:
        raise StoreError(f"cannot read {path}: {str(error).splitlines()[0]}; evaluate again") from None


def score_runs(
    key: AnswerKey,
    runs: Sequence[_Run],
    opened: Callable[[_Run], Submission],
    iou: float,
    refuse: Callable[[StoreError | InputError], None],
) -> list[tuple[_Run, ScoredRun]]:
    """Score runs, in their order, each `opened` when its turn comes; returns each with its scores.

    One that cannot be scored is left out once `refuse` has been called with the reason, if that does not raise it.
    """
    done: list[tuple[_Run, ScoredRun]] = []
    for start in range(0, len(runs), _RUNS_AT_ONCE):
        batch = runs[start : start + _RUNS_AT_ONCE]
        going: dict[int, _Scoring] = {}

        @contextlib.contextmanager
        def refusing(number: int, going: dict[int, _Scoring] = going) -> Iterator[None]:
            try:
                yield
            except (StoreError, InputError) as error:
                going.pop(number, None)
                refuse(error)

        for number, run in enumerate(batch):
            with refusing(number):
                going[number] = _Scoring(key, opened(run))
        for first, truth in key.groups():
            for number, own in list(going.items()):
                with refusing(number):
                    own.add(truth, first, iou)
        for number, own in list(going.items()):
            with refusing(number):
                own.check_end()
        done += [(batch[number], own.run) for number, own in going.items()]
    return done


class _Scoring:
    """A run that is being scored: `run` fills up as sequences are added."""

    def __init__(self, key: AnswerKey, submitted: Submission) -> None:
        """Raises StoreError where the run's questions are not the store's."""
        self._key, self._parts = key, submitted.predictions
        self._rest = SCORED.empty_table()
        manifest = submitted.manifest
        self._run_id = manifest.run_id
        rows = question_rows(key.ids, manifest.run_id, manifest.question_ids)
        scores = np.zeros((len(rows), len(SCORES)), np.int8)
        invalid = np.zeros(len(rows), np.int8)
        # The rows say which questions: their ids take more memory than all else of a run.
        slim = msgspec.structs.replace(manifest, question_ids=())
        self.run = ScoredRun(slim, np.sort(rows), scores, invalid, len(rows), key.ids, submitted.answers)

    def add(self, truth: Truth, first: int, iou: float) -> None:
        """Score the predictions of some sequences. `first`: the row of the first of their questions."""
        low, high = np.searchsorted(self.run.rows, [first, first + len(truth.ids)]).tolist()
        predictions = self._next_of(truth.ids)
        if low == high and not len(predictions):
            return
        ids = truth.ids.take(pa.array(self.run.rows[low:high] - first)).to_pylist()
        found = score_predictions(truth, self._run_id, ids, predictions, iou)
        for place, name in enumerate(SCORES):
            self.run.scores[low:high, place] = found[f"{name}_score"].to_numpy()
        self.run.invalid[low:high] = found["invalid"].to_numpy()
        self.run.errors -= int(np.count_nonzero(is_judged(predictions["status"])))

    def check_end(self) -> None:
        """Raise StoreError where predictions are left over."""
        if self._more():
            name = self._rest["question_id"][0].as_py()
            if self._key.place(name) < 0:
                raise stray_prediction(self._run_id, name)
            raise StoreError(f"run {self._run_id} holds its predictions in another order: use a new run id")

    def _next_of(self, ids: pa.Array) -> pa.Table:
        """The next predictions, up to the first that is of none of these questions."""
        found = [SCORED.empty_table()]
        while self._more():
            # No more than these can be of them, but for one that is there twice.
            foreign = row_numbers(self._rest["question_id"].slice(0, len(ids) + 1), ids) < 0
            count = int(np.argmax(foreign)) if foreign.any() else len(foreign)
            found.append(self._rest.slice(0, count))
            self._rest = self._rest.slice(count)
            if foreign.any():
                break
        return pa.concat_tables(found)

    def _more(self) -> bool:
        while not len(self._rest):
            part = next(self._parts, None)
            if part is None:
                return False
            self._rest = part
        return True


def write_scores(store: Store, run: ScoredRun, iou: float) -> None:
    """Write `scores.parquet` of a run, with the threshold in its metadata."""
    path = store.run_path(run.manifest.run_id) / "scores.parquet"
    write_table(path, scores_table(run), RUNS["scores"], {"evidence_iou": f"{iou:g}"})


def scores_table(run: ScoredRun) -> pa.Table:
    """The table `scores` of a run."""
    names = [f"{name}_score" for name in SCORES]
    columns = {name: run.scores[:, place] for place, name in enumerate(names)}
    ids = run.ids.take(pa.array(run.rows))
    run_ids = pa.repeat(pa.scalar(run.manifest.run_id), len(ids))
    return pa.table(
        {"run_id": run_ids, "question_id": ids, **columns, "invalid": run.invalid.astype(bool)}, RUNS["scores"]
    )
