"""Scores of predictions.

Each question of a run has one row with three scores of 0 or 1. The answer score compares the answer with the true
answer under the question's answer mode (`schema/answer_modes.py`). The evidence score compares the evidence box with
the target's box. The combined score is the product of the two scores. Missing, unreadable and failed predictions score
0. Therefore each mean covers all questions of the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.report.truth import FRAME_LIMIT, Truth, frame_key, read_answer, row_numbers
from jrdb_avr.schema.answer_modes import same_answer
from jrdb_avr.schema.answers import TIE
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.errors import InputError, StoreError
from jrdb_avr.schema.panorama import WIDTH
from jrdb_avr.schema.tables import RUNS

DEFAULT_IOU: Final = 0.5
"""Default minimum IoU with the target's box that makes an evidence box right."""


def score_predictions(
    truth: Truth, run_id: str, question_ids: Sequence[str], predictions: pa.Table, iou: float = DEFAULT_IOU
) -> pa.Table:
    """Score the predictions of a run.

    Args:
        truth: The true answers and evidence. It must have all questions of the run.
        run_id: The id of the run, for the table and for messages.
        question_ids: The ids of the run's n questions.
        predictions: Rows of the table `predictions`, in any order.
        iou: Minimum IoU of the evidence box and the target's box, in (0, 1]. Evidence with a smaller IoU is wrong.

    Returns:
        The table `scores` with one row per question of the run, in the order of `question_ids`.

    Raises:
        StoreError: If `truth` lacks a question of the run, if a prediction is not about a question of the run, or if a
            question has two predictions.
        InputError: If `iou` is outside (0, 1].
    """
    if not 0.0 < iou <= 1.0:
        raise InputError(f"the IoU threshold {iou:g} is outside (0, 1]", field="iou")
    questions = pa.array(question_ids, pa.string())
    rows = find_questions(truth.ids, run_id, question_ids)
    question_of = row_numbers(predictions["question_id"], questions)
    if (question_of < 0).any():
        stray = predictions["question_id"][int(np.argmin(question_of))].as_py()
        raise StoreError(f"run {run_id} predicts {stray!r}, which is not one of its questions: use a new run id")
    if len(np.unique(question_of)) < len(question_of):
        raise StoreError(f"run {run_id} has two predictions of one question: evaluate under a new run id")

    # A question without a prediction becomes a row of nulls. Such a row scores 0, as an error does.
    indexes = pc.index_in(questions, value_set=predictions["question_id"].combine_chunks())
    table = predictions.take(indexes)
    judged = is_judged(table["status"])
    numbers, texts = rows.tolist(), table["answer"].to_pylist()
    answers = [read_answer(truth.modes[row], text) for row, text in zip(numbers, texts, strict=True)]
    right = [
        same_answer(answer, truth.answers[row], truth.seconds[row])
        for row, answer in zip(numbers, answers, strict=True)
    ]
    answer_score = judged & np.array(right, dtype=bool)
    frame, box, boxed = read_boxes(table)
    present, target = find_target_boxes(truth, rows, frame)
    evidence_score = judged & boxed & present & (box_ious(box, target) >= iou - TIE)
    # Only imported predictions can have invalid answers or boxes, because a run checks what its method returns.
    unread = [text is not None and answer is None for text, answer in zip(texts, answers, strict=True)]
    unread_box = _flags(pc.is_valid(table["evidence_frame"])) & ~boxed
    invalid = judged & (_flags(pc.equal(table["status"], "invalid")) | np.array(unread, dtype=bool) | unread_box)
    return pa.table(
        {
            "run_id": pa.array([run_id] * len(rows), pa.string()),
            "question_id": questions,
            "answer_score": answer_score.astype(np.int8),
            "evidence_score": evidence_score.astype(np.int8),
            "combined_score": (answer_score & evidence_score).astype(np.int8),
            "invalid": invalid,
        },
        schema=RUNS["scores"],
    )


def find_questions(ids: pa.Array, run_id: str, question_ids: Sequence[str]) -> Ints:
    """Find the questions of a run among the questions of the store.

    Args:
        ids: The ids of the store's questions.
        run_id: The id of the run, for messages.
        question_ids: The ids of the run's n questions.

    Returns:
        The row numbers of the run's questions in `ids`, in the order of `question_ids`. Shape: (n,).

    Raises:
        StoreError: If the store lacks a question of the run, or if the run lists a question twice.
    """
    rows = row_numbers(pa.array(question_ids, pa.string()), ids)
    if (rows < 0).any():
        missing = question_ids[int(np.argmin(rows))]
        raise StoreError(f"run {run_id} lists question {missing!r}, which the store does not have")
    if len(np.unique(rows)) < len(rows):
        raise StoreError(f"run {run_id} lists a question twice: its run.json is broken")
    return rows


def is_judged(status: pa.ChunkedArray) -> Bools:
    """Return whether each prediction can get a score above 0. Shape: (n,).

    Missing predictions, and predictions that ended in an error, always score 0.
    """
    return _flags(pc.is_in(status, value_set=pa.array(["answered", "invalid"])))


def read_boxes(predictions: pa.Table) -> tuple[Ints, Floats, Bools]:
    """Read the evidence of predictions.

    Args:
        predictions: n rows of the table `predictions`.

    Returns:
        Three arrays. The first has the indexes of the frames. Shape: (n,). The second has the boxes as x, y, w, h in
        stitched pixels. Shape: (n, 4). The third says whether each evidence can be scored: its box is complete and
        finite, and its frame is at least 0 and less than `FRAME_LIMIT`. Shape: (n,).
    """
    box = np.stack([predictions[f"evidence_{side}"].to_numpy().astype(np.float64) for side in "xywh"], axis=1)
    frame = pc.fill_null(predictions["evidence_frame"], -1).to_numpy().astype(np.int64)
    return frame, box, np.isfinite(box).all(axis=1) & (frame >= 0) & (frame < FRAME_LIMIT)


def find_target_boxes(truth: Truth, rows: Ints, frame: Ints) -> tuple[Bools, Floats]:
    """Find, for each question, the box of the question's target in a given frame.

    Args:
        truth: The true answers and evidence.
        rows: For each question, its row number in `truth`. Shape: (n,).
        frame: Index of the frame of the evidence, for each question. Shape: (n,).

    Returns:
        Two arrays. The first says whether the target has a box in the frame. Shape: (n,). The second has the box as x,
        y, w, h in stitched pixels. Shape: (n, 4). If the target has no box, these four values have no meaning.
    """
    if not len(truth.keys):
        return np.zeros(len(rows), dtype=bool), np.zeros((len(rows), 4))
    key = frame_key(truth.targets[rows], np.clip(frame, 0, FRAME_LIMIT - 1))
    index = np.minimum(np.searchsorted(truth.keys, key), len(truth.keys) - 1)
    return truth.keys[index] == key, truth.boxes[index]


def box_ious(first: Floats, second: Floats) -> Floats:
    """Compute the IoU of each box in `first` with the box in the same row of `second`.

    Boxes may cross the seam of the panorama. The values are the same as those of `iou` in `schema/panorama.py`, which
    compares one pair of boxes per call.

    Args:
        first: Boxes as x, y, w, h in stitched pixels. Shape: (n, 4).
        second: Boxes as x, y, w, h in stitched pixels. Shape: (n, 4).

    Returns:
        The IoU for each row, 0 if one of the row's boxes has no area. Shape: (n,).
    """
    ax, ay, aw, ah = first.T
    bx, by, bw, bh = second.T
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        rows = np.minimum(ay + ah, by + bh) - np.maximum(ay, by)
        turn = np.round((ax + aw / 2 - bx - bw / 2) / WIDTH) * WIDTH
        columns = np.full(len(first), -np.inf)
        for shift in (turn - WIDTH, turn, turn + WIDTH):
            columns = np.maximum(columns, np.minimum(ax + aw, bx + shift + bw) - np.maximum(ax, bx + shift))
        overlap = columns * rows
        share = np.minimum(1.0, overlap / (aw * ah + bw * bh - overlap))
    meets = (aw > 0) & (ah > 0) & (bw > 0) & (bh > 0) & (rows > 0) & (columns > 0)
    return np.where(meets & np.isfinite(share), share, 0.0)


def _flags(values: Any) -> Bools:
    flags: Bools = pc.fill_null(values, False).to_numpy(zero_copy_only=False).astype(bool)
    return flags
