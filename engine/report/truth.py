"""True answers and evidence of a store's questions, as arrays, so that they can be compared with predictions."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answer_modes import MODES, decode_answer, frames_of_answer
from jrdb_avr.schema.answers import Answer, Choice, Number
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.errors import DecodeError, StoreError
from jrdb_avr.schema.questions import IMPORTED_KEY
from jrdb_avr.schema.tables import QUESTIONS

FRAME_LIMIT: Final = 1 << 24
"""Exclusive upper limit of frame indexes."""

_TRACK_LIMIT: Final = 1 << 32
"""Exclusive upper limit of track ids."""

_COLUMNS: Final = {
    "questions": ("question_id", "sequence", "answer_mode"),
    "sequences": ("sequence", "fps"),
    "answers": ("question_id", "answer", "target_track"),
    "evidence": QUESTIONS["evidence"].names,
}


def sort_by_sequence(questions: pa.Table) -> pa.Table:
    """Return rows sorted by the columns `sequence` and `question_id`. All tables of runs have this order."""
    return questions.sort_by([("sequence", "ascending"), ("question_id", "ascending")])


def fit_schema(table: pa.Table, schema: pa.Schema, path: Path, command: str) -> pa.Table:
    """Convert a table to the columns and types of a schema. Columns that the schema lacks are dropped.

    Args:
        table: Table that was read from `path`.
        schema: Schema of the result.
        path: File that the error message names.
        command: Command or advice for the error message, such as "generate". The message ends in this text, followed
            by "again".

    Returns:
        The table with the columns and types of the schema.

    Raises:
        StoreError: If a column is missing or cannot be cast to the type in the schema.
    """
    missing = set(schema.names) - set(table.column_names)
    if missing:
        raise StoreError(f"{path} lacks the columns {', '.join(sorted(missing))}: {command} again")
    try:
        return table.select(schema.names).cast(schema)
    except (ValueError, pa.ArrowException) as error:
        raise StoreError(f"{path} has other column types ({str(error).splitlines()[0]}): {command} again") from None


class Truth:
    """True answers of n questions, and the boxes of the questions' targets.

    Attributes:
        ids: Id of each of the n questions.
        modes: Answer mode of each of the n questions.
        answers: True answer to each of the n questions.
        seconds: Number of frames per second in the sequence of each of the n questions.
        targets: Index of each question's target among the people that have boxes. -1 for a target without a box.
            Shape: (n,).
        keys: Key of each box, ascending. `frame_key` makes it from the person and the frame. Shape: (boxes,).
        boxes: Boxes as x, y, w, h in stitched pixels, in the order of `keys`. Shape: (boxes, 4).
    """

    def __init__(self, questions: pa.Table, sequences: pa.Table, answers: pa.Table, evidence: pa.Table) -> None:
        """Join four tables of the folder `questions/`. Rows and columns that are not needed here may be missing.

        Raises:
            StoreError: If a table lacks a row that another table refers to, or if an answer cannot be read.
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
        if (self.keys[1:] < self.keys[:-1]).any():  # Rarely true, because `generate` writes sorted boxes.
            order = np.argsort(self.keys, kind="stable")
            self.keys, self.boxes = self.keys[order], self.boxes[order]


def read_truth(store: Store) -> Truth:
    """Read the true answers and evidence of a store.

    Args:
        store: A store that has questions, answers and evidence.

    Returns:
        The true answers and evidence of all questions, in the order of `sort_by_sequence`.

    Raises:
        StoreError: If a table is missing, if a table has other columns than expected, or if not all tables come from
            the same run of `generate`.
    """
    tables = store.question_tables(*_COLUMNS, columns=_COLUMNS)
    questions, *others = (
        fit_schema(table, pa.schema(map(QUESTIONS[name].field, columns)), store.question_path(name), "generate")
        for table, (name, columns) in zip(tables, _COLUMNS.items(), strict=True)
    )
    return Truth(sort_by_sequence(questions), *others)


def frame_key(person: Ints, frame: Ints) -> Ints:
    """Combine, in each row, the index of a person and the index of a frame into one key.

    If the keys are sorted, they are sorted by person, and the keys of each person are sorted by frame.

    Args:
        person: Indexes of people. A negative index gives a negative key. Shape: (n,).
        frame: Indexes of frames, at least 0 and less than `FRAME_LIMIT`. Shape: (n,).

    Returns:
        The keys. Shape: (n,).
    """
    return person * FRAME_LIMIT + frame


def read_answer(mode: str, text: str | None) -> Answer | None:
    """Decode a stored answer.

    Args:
        mode: The answer mode of the question.
        text: The answer as JSON, or None if there is no answer.

    Returns:
        The answer. None if there is no text, or if the text is not a valid answer under the mode.
    """
    try:
        return decode_answer(mode, text or "")
    except DecodeError:
        return None


def is_inside(answer: Answer, choices: int, frame_count: int) -> bool:
    """Return whether an answer can be true.

    Args:
        answer: Answer to a question.
        choices: Number of choices of the question.
        frame_count: Number of frames of its sequence.

    Returns:
        Whether the answer names a choice, or ascending frames of the sequence, or a number above 0.
    """
    if isinstance(answer, Choice):
        return answer.choice <= choices
    if frames := frames_of_answer(answer):
        return frames == sorted(frames) and frames[-1] < frame_count
    return not isinstance(answer, Number) or answer.value > 0


def is_imported(store: Store) -> bool:
    """Return whether another program wrote the questions of a store, so that they have no plans and no proofs."""
    return IMPORTED_KEY.encode() in (store.questions("questions", []).schema.metadata or {})


def refuse_imported(store: Store, remedy: str) -> None:
    """Raise StoreError if a store has imported questions. The message of the error ends in `remedy`."""
    if store.question_path("questions").exists() and is_imported(store):
        raise StoreError(f"{store.path} has imported questions, which have no plans: {remedy}")


def row_numbers(values: Any, among: Any) -> Ints:
    """Find the row number in the array `among` of each value in `values`.

    Args:
        values: Arrow array of the n values to find.
        among: The Arrow array to search.

    Returns:
        The row number in `among` for each value, or -1 if `among` does not have the value. Shape: (n,).
    """
    rows: Ints = pc.fill_null(pc.index_in(values, value_set=among), -1).to_numpy(zero_copy_only=False).astype(np.int64)
    return rows


def find_rows(among: pa.ChunkedArray, values: Any, table: str) -> Ints:
    """Find the row number in a column of each value in `values`. A missing value is an error.

    Args:
        among: The column to search. It belongs to a table in the folder `questions/`.
        values: The n values to find.
        table: The name of the column's table, for the error message.

    Returns:
        The row number in `among` for each value. Shape: (n,).

    Raises:
        StoreError: If a value is not in the column.
    """
    rows = row_numbers(values, among.combine_chunks())
    if (rows < 0).any():
        raise StoreError(f"the tables in questions/ do not match ({table} lacks a row): generate again")
    return rows
