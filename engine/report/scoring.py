"""Scores of predictions.

Every question gets one row: its answer compared under its answer mode, its evidence box compared with the
target's boxes, and the product of both. Missing, unreadable and failed predictions score 0, and n stays the number of
questions. Answers are compared by `schema/answers.py`; the overlap of boxes is that of `schema/panorama.py`, here over
arrays. 25 runs of 2,098 questions take about a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.answer_modes import MODES, decode_answer, same_answer
from jrdb_avr.schema.answers import TIE, Answer
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.errors import DecodeError, InputError, StoreError
from jrdb_avr.schema.panorama import WIDTH
from jrdb_avr.schema.tables import RUNS

DEFAULT_IOU: Final = 0.5
MOST_FRAMES: Final = 1 << 24
"""Above every frame number."""


class Truth:
    """The right answers of some questions, one row each, and the target's boxes sorted by key (row, frame).

    modes, seconds: per question its answer mode, and a second in frames.
    """

    def __init__(self, questions: pa.Table, sequences: pa.Table, answers: pa.Table, evidence: pa.Table) -> None:
        """From the four tables of `questions/`, or their rows and columns that matter.

        Raises StoreError where they do not fit together.
        """
        self.ids = questions["question_id"].combine_chunks()
        answer_row = find_rows(answers["question_id"], self.ids, "answers")
        sequence_row = find_rows(sequences["sequence"], questions["sequence"], "sequences")
        self.modes: list[str] = questions["answer_mode"].to_pylist()
        if not MODES.keys() >= set(self.modes):
            raise StoreError("the questions name an unknown answer mode: generate again")
        texts = answers["answer"].take(pa.array(answer_row)).to_pylist()
        self.answers = [answer for answer in map(read_answer, self.modes, texts) if answer is not None]
        if len(self.answers) < len(texts):
            raise StoreError("an answer of the store cannot be read under its mode: generate again")
        row = find_rows(self.ids, evidence["question_id"], "questions")
        self.keys = frame_key(row, evidence["frame"].to_numpy().astype(np.int64))
        self.boxes = np.stack([evidence[name].to_numpy() for name in "xywh"], axis=1)
        if (self.keys[1:] < self.keys[:-1]).any():  # `generate` writes them sorted; copying a million is expensive.
            order = np.argsort(self.keys, kind="stable")
            self.keys, self.boxes = self.keys[order], self.boxes[order]
        self.seconds: list[int] = np.round(sequences["fps"].to_numpy()[sequence_row]).astype(np.int64).tolist()


def score_predictions(
    truth: Truth, run_id: str, question_ids: Sequence[str], predictions: pa.Table, iou: float = DEFAULT_IOU
) -> pa.Table:
    """The `scores` table of one run: a row for each of its questions, in their order.

    `predictions` has the columns of that table. Raises StoreError for a prediction of a question that is not one of the
    run's, two predictions of one question, or a question that the store lacks; InputError for a threshold outside
    (0, 1].
    """
    if not 0.0 < iou <= 1.0:
        raise InputError(f"an IoU threshold lies in (0, 1], not at {iou:g}", field="iou")
    questions = pa.array(question_ids, pa.string())
    row = question_rows(truth.ids, run_id, question_ids)
    answered_by = row_numbers(predictions["question_id"], questions)
    if (answered_by < 0).any():
        raise stray_prediction(run_id, predictions["question_id"][int(np.argmin(answered_by))].as_py())
    if len(np.unique(answered_by)) < len(answered_by):
        raise StoreError(f"run {run_id} has two predictions of one question: evaluate under a new run id")

    # A question without a prediction counts as an error too: its row is null.
    places = pc.index_in(questions, value_set=predictions["question_id"].combine_chunks())
    table = predictions.take(places)
    judged = is_judged(table["status"])
    invalid = judged & _flags(pc.equal(table["status"], "invalid"))

    numbers, texts = row.tolist(), table["answer"].to_pylist()
    answers = [read_answer(truth.modes[i], text) for i, text in zip(numbers, texts, strict=True)]
    right = [same_answer(own, truth.answers[i], truth.seconds[i]) for i, own in zip(numbers, answers, strict=True)]
    answer_score = judged & np.array(right, dtype=bool)
    frame, box, boxed = predicted_boxes(table)
    present, target = target_boxes(truth, row, frame)
    evidence_score = judged & boxed & present & (box_ious(box, target) >= iou - TIE)
    # A stored answer or box that is none was no method's of this program.
    unread = [text is not None and answer is None for text, answer in zip(texts, answers, strict=True)]
    invalid |= judged & (np.array(unread, dtype=bool) | (_flags(pc.is_valid(table["evidence_frame"])) & ~boxed))
    return pa.table(
        {
            "run_id": pa.array([run_id] * len(row), pa.string()),
            "question_id": questions,
            "answer_score": answer_score.astype(np.int8),
            "evidence_score": evidence_score.astype(np.int8),
            "combined_score": (answer_score & evidence_score).astype(np.int8),
            "invalid": invalid,
        },
        schema=RUNS["scores"],
    )


def question_rows(ids: pa.Array, run_id: str, question_ids: Sequence[str]) -> Ints:
    """The row of each question of a run among `ids`. Raises StoreError where one is not there, or listed twice."""
    rows = row_numbers(pa.array(question_ids, pa.string()), ids)
    if (rows < 0).any():
        missing = question_ids[int(np.argmin(rows))]
        raise StoreError(f"run {run_id} lists question {missing!r}, which the store does not have")
    if len(np.unique(rows)) < len(rows):
        raise StoreError(f"run {run_id} lists a question twice: its run.json is broken")
    return rows


def stray_prediction(run_id: str, question_id: str) -> StoreError:
    """The error of a prediction of a question that is not one of the run's."""
    return StoreError(f"run {run_id} predicts {question_id!r}, which is not one of its questions: use a new run id")


def is_judged(status: pa.ChunkedArray) -> Bools:
    """Whether a prediction of each status counts: not one that ended in an error."""
    return _flags(pc.is_in(status, value_set=pa.array(["answered", "invalid"])))


def frame_key(row: Ints | int, frame: Ints) -> Ints:
    """One number for a row and a frame; `Truth.keys` are such numbers, sorted."""
    return row * MOST_FRAMES + frame


def predicted_boxes(predictions: pa.Table) -> tuple[Ints, Floats, Bools]:
    """Frames (n), boxes (n, 4) and which of them are present and finite."""
    box = np.stack([predictions[f"evidence_{key}"].to_numpy().astype(np.float64) for key in "xywh"], axis=1)
    frame = pc.fill_null(predictions["evidence_frame"], -1).to_numpy().astype(np.int64)
    return frame, box, np.isfinite(box).all(axis=1) & (frame >= 0) & (frame < MOST_FRAMES)


def target_boxes(truth: Truth, row: Ints, frame: Ints) -> tuple[Bools, Floats]:
    """Whether each question's target has a box in a frame, and its box (n, 4); of no meaning where it has none."""
    if not len(truth.keys):
        return np.zeros(len(row), dtype=bool), np.zeros((len(row), 4))
    key = frame_key(row, np.clip(frame, 0, MOST_FRAMES - 1))
    at = np.minimum(np.searchsorted(truth.keys, key), len(truth.keys) - 1)
    return truth.keys[at] == key, truth.boxes[at]


def box_ious(a: Floats, b: Floats) -> Floats:
    """Seam-aware IoU of boxes (n, 4) as x, y, w, h in stitched pixels, row by row: `iou` over arrays."""
    ax, ay, aw, ah = a.T
    bx, by, bw, bh = b.T
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        rows = np.minimum(ay + ah, by + bh) - np.maximum(ay, by)
        turn = np.round((ax + aw / 2 - bx - bw / 2) / WIDTH) * WIDTH
        columns = np.full(len(a), -np.inf)
        for shift in (turn - WIDTH, turn, turn + WIDTH):
            columns = np.maximum(columns, np.minimum(ax + aw, bx + shift + bw) - np.maximum(ax, bx + shift))
        overlap = columns * rows
        share = np.minimum(1.0, overlap / (aw * ah + bw * bh - overlap))
    meets = (aw > 0) & (ah > 0) & (bw > 0) & (bh > 0) & (rows > 0) & (columns > 0)
    return np.where(meets & np.isfinite(share), share, 0.0)


# -- columns ------------------------------------------------------------------------------------------------------


def read_answer(mode: str, text: str | None) -> Answer | None:
    """A stored answer; None without one, and for a text that is no answer of the mode."""
    try:
        return decode_answer(mode, text or "")
    except DecodeError:
        return None


def row_numbers(values: Any, among: Any) -> Ints:
    """The row of each value in `among`, or -1."""
    rows: Ints = pc.fill_null(pc.index_in(values, value_set=among), -1).to_numpy(zero_copy_only=False).astype(np.int64)
    return rows


def find_rows(among: Any, values: Any, table: str) -> Ints:
    """The row of each value in a column of a table of `questions/`. Raises StoreError where one is not there."""
    rows = row_numbers(values, among.combine_chunks() if isinstance(among, pa.ChunkedArray) else among)
    if (rows < 0).any():
        raise StoreError(f"the tables of questions/ do not fit together ({table} lacks a row): generate again")
    return rows


def _flags(values: Any) -> Bools:
    flags: Bools = pc.fill_null(values, False).to_numpy(zero_copy_only=False).astype(bool)
    return flags
