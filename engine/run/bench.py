"""The public half of a benchmark: questions and pictures, handed out as tasks and episodes.

Only public files are read. The private half, answers and evidence, is `judge.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from jrdb_avr.agent.methods.episode import BUDGET, Episode
from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.run.opaque import opaque_names
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.selection import select_questions
from jrdb_avr.queries.questions import QuestionRow, read_question_rows, read_sequences
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.card import is_of_sample
from jrdb_avr.schema.errors import InputError, StoreError
from jrdb_avr.schema.method import Question, Record, RecordWrite, Task


class Bench:
    """Questions of a store and their pictures, as a player gets them. Safe for many threads.

    `questions`: in order, with opaque names of sequences where those are used; `sequences`: by those names.
    `observer`: their pictures, of the sequences `observed` in the `folders` of opaque ones. `synthetic`: whether any is
    about a sample world.

        bench = Bench.open("store")
        episode = bench.episode(bench.questions[0].question_id)
    """

    def __init__(self, store: Store, questions: Sequence[QuestionRow], image_root: str | None, opaque: bool) -> None:
        """Hold the given questions; `Bench.open` selects them first. Raises StoreError for one of no known sequence."""
        found = read_sequences(store)
        if unknown := sorted({question.sequence for question in questions} - found.keys()):
            raise StoreError(f"questions are about {unknown[0][:120]!r}, which sequences.parquet lacks: generate again")
        names = opaque_names(store, found) if opaque else {name: name for name in found}
        self.sequences = {names[name]: replace(info, sequence=names[name]) for name, info in found.items()}
        self.questions = [replace(row.to_question(), sequence=names[row.sequence]) for row in questions]
        self.synthetic = any(is_of_sample(question.sequence) for question in questions)
        self._by_id = {question.question_id: question for question in self.questions}
        chosen = {question.sequence for question in questions}
        self.observed = [self.sequences[names[name]] for name in sorted(chosen)]
        self.folders = {names[name]: name for name in chosen} if opaque else None
        self.observer = Observer(image_root, self.observed, folders=self.folders)

    @classmethod
    def open(
        cls,
        store: Store | str | Path,
        *,
        questions: QuestionSelection | Iterable[str] | None = None,
        limit: int | None = None,
        images: str | Path | None = None,
        opaque: bool = False,
    ) -> Bench:
        """The questions of a selection or with these ids (all without), at most `limit`, that have panoramas.

        `images` stands in for the store's panoramas; `opaque`: whether players get opaque names of sequences.
        Raises StoreError where a public file is missing or nothing is left, InputError for an unknown name.
        """
        store = Store.of(store)
        image_root = find_images(store, images)
        chosen = select_questions(read_question_rows(store), QuestionSelection.of(questions, limit), image_root)
        return cls(store, chosen, image_root, opaque)

    def question(self, question_id: str) -> Question:
        """The question with this id. Raises InputError for an unknown one."""
        if question_id not in self._by_id:
            raise InputError(f"no question {question_id[:40]!r} among the {len(self.questions)}", field="question_id")
        return self._by_id[question_id]

    def task(
        self,
        question_id: str,
        record: Record = lambda step: None,
        record_write: RecordWrite = lambda write: None,
    ) -> Task:
        """What a method receives; its steps and writes go to the functions. Raises InputError for an unknown id."""
        question = self.question(question_id)
        info = self.sequences[question.sequence]
        return Task(question, info, self.observer, self.observer.stored, record, record_write)

    def episode(self, question_id: str, *, budget: int = BUDGET, record: Record = lambda step: None) -> Episode:
        """Begin to play a question. Raises InputError for an unknown id."""
        return Episode(self.task(question_id, record), budget=budget)


_LABELS_BESIDE: Final = ("image_stitched", "images")
"""Names of the folders between panoramas and the root that also holds the labels."""


def root_of_images(images: str | Path) -> Path:
    """The folder in which annotations stand beside these panoramas, if they are part of a JRDB root."""
    root = Path(images).resolve()
    for name in _LABELS_BESIDE:
        root = root.parent if root.name == name else root
    return root


def find_images(store: Store, images: str | Path | None) -> str | None:
    """The folder of panoramas: `images`, or the store's own; None where a store was loaded without.

    Raises StoreError where the store has no manifest to name it.
    """
    if images is not None:
        return str(images)
    if store.question_path("questions").exists() and not (store.path / "store.json").exists():
        raise StoreError(f"{store.path} has no store.json, which names the panoramas: give their folder by --images")
    return store.manifest().image_root
