"""The right answers of a store's questions, in memory without their evidence, which is read a few sequences at a time.

What is held of a question are its id, its sequence, its answer mode and its answer: 100 bytes or so. Evidence is a
thousand times as much.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.report.scoring import Truth, find_rows
from jrdb_avr.queries.questions import fitted, in_order
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.tables import QUESTIONS

MOST_BOXES: Final = 1 << 17
"""Boxes of evidence that are gathered before predictions are scored by them: some 20 MB."""

_COLUMNS: Final = {
    "questions": ("question_id", "sequence", "answer_mode"),
    "sequences": ("sequence", "fps"),
    "answers": ("question_id", "answer"),
}


class AnswerKey:
    """The answers of a store's questions, in the order of `in_order`.

    ids: of the questions; sequences: those that have questions, sorted; starts: the row of the first question of each,
    and the number of questions.
    """

    def __init__(self, store: Store) -> None:
        """Raises StoreError where a table is missing or unfit, or of another generation than the others."""
        found = store.question_tables(*_COLUMNS, columns=_COLUMNS)
        questions, self._rates, answers = (
            fitted(table, pa.schema(map(QUESTIONS[name].field, columns)), store.question_path(name), "generate")
            for table, (name, columns) in zip(found, _COLUMNS.items(), strict=True)
        )
        # Its metadata hold the mark of the generation, which evidence has too.
        self._generation = found[0].slice(0, 0)
        self._store, self._questions = store, in_order(questions)
        self.ids = self._questions["question_id"].combine_chunks()
        self._answers = answers.take(pa.array(find_rows(answers["question_id"], self.ids, "answers")))
        counts = self._questions["sequence"].value_counts()
        self.sequences: list[str] = counts.field("values").to_pylist()
        self.starts: Ints = np.concatenate([[0], np.cumsum(counts.field("counts").to_numpy())]).astype(np.int64)

    def place(self, question_id: str) -> int:
        """The place of a question's sequence in `sequences`; -1 for a question that the store lacks."""
        row = pc.index(self.ids, question_id).as_py()
        return -1 if row < 0 else int(np.searchsorted(self.starts, row, side="right")) - 1

    def truth(self, low: int = 0, high: int | None = None) -> Truth:
        """The truth of the sequences with these places, all without them. Raises StoreError for unfit evidence."""
        names = self.sequences[low:high]
        return self._truth(low, list(map(self._evidence, names)))

    def groups(self) -> Iterator[tuple[int, Truth]]:
        """The truth of all questions, of a few whole sequences at a time, each with the row of its first question."""
        low, parts, boxes = 0, [], 0
        for high, name in enumerate(self.sequences, 1):
            parts.append(self._evidence(name))
            boxes += len(parts[-1])
            if boxes >= MOST_BOXES or high == len(self.sequences):
                truth = self._truth(low, parts)
                start, low, parts, boxes = int(self.starts[low]), high, [], 0
                yield start, truth

    def _evidence(self, sequence: str) -> pa.Table:
        table = self._store.evidence(sequence, self._generation)
        return fitted(table, QUESTIONS["evidence"], self._store.evidence_path(sequence), "generate")

    def _truth(self, low: int, evidence: Sequence[pa.Table]) -> Truth:
        start, end = self.starts[[low, low + len(evidence)]].tolist()
        questions, answers = (table.slice(start, end - start) for table in (self._questions, self._answers))
        boxes = pa.concat_tables([QUESTIONS["evidence"].empty_table(), *evidence])
        return Truth(questions, self._rates, answers, boxes)
