"""True answers and evidence of a store's questions, in the arrays that predictions are compared with."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.questions import fit_schema, sort_by_sequence
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answer_modes import MODES, decode_answer
from jrdb_avr.schema.answers import Answer
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.errors import DecodeError, StoreError
from jrdb_avr.schema.tables import QUESTIONS

FRAME_LIMIT: Final = 1 << 24
"""Exclusive upper limit of frame numbers."""

_TRACK_LIMIT: Final = 1 << 32
"""Exclusive upper limit of track numbers."""

_COLUMNS: Final = {
    "questions": ("question_id", "sequence", "answer_mode"),
    "sequences": ("sequence", "fps"),
    "answers": ("question_id", "answer", "target_track"),
    "evidence": QUESTIONS["evidence"].names,
}


class Truth:
    """True answers and target boxes of n questions, one row per question.

    Attributes:
        ids: Question ids (n).
        modes: Answer mode of each question (n).
        answers: True answer of each question (n).
        seconds: Frames in a second of each question's sequence (n).
        targets: Number of each question's target among the people with boxes, or -1 (n).
        keys: `frame_key` of each box, ascending (boxes).
        boxes: Boxes as x, y, w, h in stitched pixels (boxes, 4).
    """

    def __init__(self, questions: pa.Table, sequences: pa.Table, answers: pa.Table, evidence: pa.Table) -> None:
        """Join the tables of `questions/`, or rows and columns of them.

        Raises:
            StoreError: If a row that another table refers to is missing, or an answer cannot be read.
        """
        self.ids = questions["question_id"].combine_chunks()
        answers = answers.take(pa.array(find_rows(answers["question_id"], self.ids, "answers")))
        self.modes: list[str] = questions["answer_mode"].to_pylist()
        if not MODES.keys() >= set(self.modes):
            raise StoreError("the questions name an unknown answer mode: generate again")
        decoded = map(read_answer, self.modes, answers["answer"].to_pylist())
        self.answers = [answer for answer in decoded if answer is not None]
        if len(self.answers) < len(self.ids):
            raise StoreError("an answer of the store cannot be read under its mode: generate again")
        sequence_row = find_rows(sequences["sequence"], questions["sequence"], "sequences")
        self.seconds: list[int] = np.round(sequences["fps"].to_numpy()[sequence_row]).astype(np.int64).tolist()

        box_sequence = find_rows(sequences["sequence"], evidence["sequence"], "sequences")
        people, box_person = np.unique(box_sequence * _TRACK_LIMIT + evidence["track"].to_numpy(), return_inverse=True)
        target = sequence_row * _TRACK_LIMIT + answers["target_track"].to_numpy()
        first, last = (np.searchsorted(people, target, side) for side in ("left", "right"))
        self.targets: Ints = np.where(first < last, first, -1).astype(np.int64)
        self.keys = frame_key(box_person.astype(np.int64), evidence["frame"].to_numpy().astype(np.int64))
        self.boxes = np.stack([evidence[name].to_numpy() for name in "xywh"], axis=1)
        if (self.keys[1:] < self.keys[:-1]).any():  # `generate` writes sorted boxes: skip the copy of all boxes.
            order = np.argsort(self.keys, kind="stable")
            self.keys, self.boxes = self.keys[order], self.boxes[order]


def read_truth(store: Store) -> Truth:
    """Read the true answers and evidence of a store.

    Args:
        store: A store with questions and their private tables.

    Returns:
        The truth of all questions, in the order of `sort_by_sequence`.

    Raises:
        StoreError: If a table is missing, has another form, or belongs to another generation than the others.
    """
    tables = store.question_tables(*_COLUMNS, columns=_COLUMNS)
    questions, *others = (
        fit_schema(table, pa.schema(map(QUESTIONS[name].field, columns)), store.question_path(name), "generate")
        for table, (name, columns) in zip(tables, _COLUMNS.items(), strict=True)
    )
    return Truth(sort_by_sequence(questions), *others)


def frame_key(person: Ints, frame: Ints) -> Ints:
    """Combine person numbers and frame numbers into one sortable number each.

    Args:
        person: Person numbers (n); a negative number gives a negative key.
        frame: Frame numbers in [0, FRAME_LIMIT) (n).

    Returns:
        The keys (n).
    """
    return person * FRAME_LIMIT + frame


def read_answer(mode: str, text: str | None) -> Answer | None:
    """Decode a stored answer.

    Args:
        mode: The question's answer mode.
        text: The answer as JSON, or None.

    Returns:
        The answer, or None if the text is missing or is not an answer of the mode.
    """
    try:
        return decode_answer(mode, text or "")
    except DecodeError:
        return None


def row_numbers(values: Any, among: Any) -> Ints:
    """Find values in a column.

    Args:
        values: The values to find, an Arrow array (n).
        among: The array to search.

    Returns:
        The row of each value in `among`, or -1 (n).
    """
    rows: Ints = pc.fill_null(pc.index_in(values, value_set=among), -1).to_numpy(zero_copy_only=False).astype(np.int64)
    return rows


def find_rows(among: pa.ChunkedArray, values: Any, table: str) -> Ints:
    """Find values in a column of a table of `questions/`.

    Args:
        among: The column to search.
        values: The values to find (n).
        table: The name of the table that has the column, for the message.

    Returns:
        The row of each value in `among` (n).

    Raises:
        StoreError: If a value is missing.
    """
    rows = row_numbers(values, among.combine_chunks())
    if (rows < 0).any():
        raise StoreError(f"the tables of questions/ do not fit together ({table} lacks a row): generate again")
    return rows
