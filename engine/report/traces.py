"""Trace of a run's work on one question: the steps, the looks, the writes to the world model, and the true answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.report.run_scores import predictions_path
from jrdb_avr.engine.report.scoring import score_predictions
from jrdb_avr.engine.report.truth import Truth
from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.queries.store import Store, open_parquet
from jrdb_avr.schema.beliefs import Fact
from jrdb_avr.schema.errors import InputError, StoreError
from jrdb_avr.schema.panorama import CROP, WIDTH

StoredRow = Mapping[str, Any]

_DIGITS: Final = 8
"""Exclusive upper limit of the number of digits in a frame id."""


def read_rows(path: Path, column: str, value: str) -> pa.Table:
    """Read those rows of a Parquet table that have a given value in a column.

    If no row of a row group has the value, the other columns of the row group are not read. Raises StoreError if the
    file is missing or broken.
    """
    with open_parquet(path) as file:
        parts = [file.schema_arrow.empty_table()]
        for index in range(file.num_row_groups):
            if pc.index(file.read_row_group(index, [column])[column], value).as_py() >= 0:
                group = file.read_row_group(index)
                parts.append(group.filter(pc.equal(group[column], value)))
        return pa.concat_tables(parts)


@dataclass(frozen=True)
class Look:
    """A look of a run. It shows a crop of a frame, or the whole panorama of a frame.

    Attributes:
        step: Index of the look's step.
        frame: Index of the frame.
        angle: Panorama angle of the crop's centre in degrees, or None for a whole panorama.
        left: Left column of the crop in stitched pixels. 0 for a whole panorama.
    """

    step: int
    frame: int
    angle: float | None
    left: int

    @property
    def spans(self) -> list[tuple[int, int]]:
        """Spans of panorama columns that the look shows, as (start, width). A crop across the seam has two spans."""
        if self.angle is None:
            return [(0, WIDTH)]
        over = self.left + CROP - WIDTH
        return [(self.left, CROP)] if over <= 0 else [(self.left, CROP - over), (0, over)]


@dataclass(frozen=True)
class Written:
    """A write to the world model.

    Attributes:
        row: The write's row of the table `world`.
        step: Index of the step that made the write.
        fact: The written fact.
    """

    row: StoredRow
    step: int
    fact: Fact


class Transcript:
    """Record of a run's work on one question. Only public files are read.

    Attributes:
        manifest: The run's manifest.
        question: The question's row of the table `questions`.
        prediction: The question's row of the table `predictions`.
        fps: Frames per second of the question's sequence.
        steps: The question's rows of the table `steps`, sorted by step.
        looks: The looks that the steps record, in the order of the steps.
        writes: All writes to the world model, in the order of time.
    """

    def __init__(self, store: Store, run_id: str, question_id: str) -> None:
        """Read the record of one question.

        Raises:
            StoreError: If the run is missing or unfinished.
            InputError: If the run does not have the question.
        """
        self.manifest = read_run_manifest(store, run_id)
        self._predictions = read_rows(predictions_path(store, run_id), "question_id", question_id)
        if not self._predictions.num_rows:
            raise InputError(f"run {run_id} does not have question {question_id[:40]!r}", field="question_id")
        questions, sequences = store.question_tables("questions", "sequences")
        questions = _rows_of(questions, question_id)
        if not questions.num_rows:
            raise InputError(f"no question {question_id[:40]!r} in {store.path}", field="question_id")
        (self.question,), (self.prediction,) = (table.to_pylist() for table in (questions, self._predictions))
        self.fps = {row["sequence"]: row["fps"] for row in sequences.to_pylist()}[self.question["sequence"]]
        path = store.run_path(run_id)
        self.steps = read_rows(path / "steps.parquet", "question_id", question_id).sort_by("step").to_pylist()
        self.looks = [look for step in self.steps if (look := look_of(step)) is not None]
        world = path / "world.parquet"
        rows = read_rows(world, "question_id", question_id).sort_by("number").to_pylist() if world.exists() else []
        self.writes = [Written(row, row["step"], _fact(row["fact"], world)) for row in rows]


class Trace(Transcript):
    """Record of a run's work on one question, with the true answer and the scores.

    Attributes:
        answer: The question's row of the table `answers`.
        target: Boxes of the target by frame, as x, y, w, h in stitched pixels.
        scores: The question's row of the table `scores`. It is computed anew, not read from a file.
    """

    def __init__(self, store: Store, run_id: str, question_id: str) -> None:
        """Read the record of one question, and score its prediction.

        Raises:
            StoreError: If the run is missing or unfinished, or if a private file of the store is missing.
            InputError: If the run does not have the question.
        """
        questions, answers, sequences, evidence = store.question_tables("questions", "answers", "sequences", "evidence")
        super().__init__(store, run_id, question_id)
        questions, answers = _rows_of(questions, question_id), _rows_of(answers, question_id)
        (self.answer,) = answers.to_pylist()
        sequence, track = self.question["sequence"], self.answer["target_track"]
        evidence = evidence.filter((pc.field("sequence") == sequence) & (pc.field("track") == track))
        truth = Truth(questions, sequences, answers, evidence)
        self.scores = score_predictions(truth, run_id, [question_id], self._predictions).to_pylist()[0]
        self.target = {row["frame"]: (row["x"], row["y"], row["w"], row["h"]) for row in evidence.to_pylist()}


class _Shown(msgspec.Struct):
    frame_id: str
    angle_deg: float | None = None
    left: int | None = None


_SHOWN = msgspec.json.Decoder(_Shown)


def look_of(step: StoredRow) -> Look | None:
    """Return the look that a step records.

    Args:
        step: A row of the table `steps`.

    Returns:
        The look. None if the step is not a look, if the look was refused, or if a custom method recorded the step in
        another format.
    """
    if step["kind"] != "observe":
        return None
    try:
        shown = _SHOWN.decode(step["response"])
    except (msgspec.DecodeError, UnicodeEncodeError):
        return None
    plain = shown.frame_id.isascii() and shown.frame_id.isdecimal() and len(shown.frame_id) < _DIGITS
    if not plain or (shown.left is None) != (shown.angle_deg is None):
        return None
    return Look(step["step"], int(shown.frame_id), shown.angle_deg, (shown.left or 0) % WIDTH)


def _rows_of(table: pa.Table, question_id: str) -> pa.Table:
    return table.filter(pc.equal(table["question_id"], question_id))


def _fact(text: str, path: Path) -> Fact:
    try:
        return msgspec.json.decode(text, type=Fact) if text else Fact()
    except msgspec.DecodeError as error:
        raise StoreError(f"{path} holds a fact that cannot be read ({error}): evaluate again") from None
