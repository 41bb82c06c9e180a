"""Readers of the public tables of a store.

One table has the questions. The other table has the sequences, with the frames that can be observed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import pyarrow as pa

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.answers import AnswerMode
from jrdb_avr.schema.errors import ObserveError, StoreError, did_you_mean
from jrdb_avr.schema.method import Question, SequenceInfo
from jrdb_avr.schema.tables import QUESTIONS

HIDDEN: Final = ("family", "template")
"""Columns of `questions` that a public store leaves out."""


@dataclass(frozen=True, slots=True)
class QuestionRow:
    """Row of `questions.parquet`. In a public store (`export --public`), `family` and `template` are ""."""

    question_id: str
    sequence: str
    family: str
    template: str
    question: str
    choices: tuple[str, ...]
    answer_mode: AnswerMode

    def to_question(self) -> Question:
        """Return the question with only those columns that a method may see."""
        return Question(self.question_id, self.sequence, self.question, self.choices, self.answer_mode)


def read_question_rows(store: Store) -> list[QuestionRow]:
    """Read the public columns of all questions.

    Args:
        store: Store with questions.

    Returns:
        The rows in the order of the file.

    Raises:
        StoreError: If the store has no questions, or if the file has wrong columns or values.
    """
    rows = _public_rows(store, "questions", HIDDEN)
    ids, modes = {row["question_id"] for row in rows}, {row["answer_mode"] for row in rows}
    if len(ids) < len(rows) or not modes <= set(MODES):
        raise StoreError(f"{store.question_path('questions')} holds an unknown mode or a repeated id: generate again")
    return [QuestionRow(**{**dict.fromkeys(HIDDEN, ""), **row, "choices": tuple(row["choices"])}) for row in rows]


def read_sequences(store: Store) -> dict[str, SequenceInfo]:
    """Read the sequences of a store's questions from `sequences.parquet`.

    Args:
        store: Store with questions.

    Returns:
        A mapping from the name of each sequence to the sequence, with the frames that can be observed.

    Raises:
        StoreError: If the file is missing or broken.
    """
    rows = _public_rows(store, "sequences")
    return {row["sequence"]: SequenceInfo(**{**row, "frames": tuple(row["frames"])}) for row in rows}


def _public_rows(store: Store, name: str, optional: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Return the rows of a public table as dictionaries. The table may lack the columns in `optional`."""
    table = store.questions(name)
    present = set(table.column_names)
    schema = pa.schema([field for field in QUESTIONS[name] if field.name in present or field.name not in optional])
    try:
        rows: list[dict[str, Any]] = table.select(schema.names).cast(schema).to_pylist()
    except (KeyError, ValueError, pa.ArrowException):
        raise StoreError(f"{store.question_path(name)} is of another version: generate again") from None
    return rows


def sequences_of_questions(store: Store) -> dict[str, str]:
    """Return a dictionary from the id of each question to the name of the question's sequence.

    Raises StoreError if the store has no questions.
    """
    table = store.questions("questions", ["question_id", "sequence"])
    # Encode the column as a dictionary, so that all questions of a sequence share one string in memory.
    encoded = table["sequence"].combine_chunks().dictionary_encode()
    names, ids = encoded.dictionary.to_pylist(), table["question_id"].to_pylist()
    return {question: names[index] for question, index in zip(ids, encoded.indices.to_pylist(), strict=True)}


def read_loaded_sequence(store: Store, name: str) -> SequenceInfo:
    """Return a loaded sequence with those frames that have a panorama. The store needs no questions.

    Args:
        store: Loaded store.
        name: Name of the sequence.

    Returns:
        The sequence with its frames in ascending order.

    Raises:
        StoreError: If nothing is loaded.
        ObserveError: If the store has no sequence of this name.
    """
    names = sorted(store.manifest().sequences)
    if name not in names:
        raise ObserveError(f"no sequence {name[:100]!r} is loaded{did_you_mean(name, names)}")
    row = store.interval("sequence", name).to_pylist()[0]
    frames = store.interval("frames", name)
    with_image = frames.filter(frames["image"])["frame"].to_pylist()
    return SequenceInfo(name, row["fps"], row["frame_count"], tuple(sorted(with_image)))
