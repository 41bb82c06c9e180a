"""Hand out questions and pictures of a store as tasks and episodes: the public half of a benchmark.

Only public files are read. `judge.py` has the private half, answers and evidence.
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
    """Questions of a store and their pictures, for players. Safe for many threads.

        bench = Bench.open("store")
        episode = bench.episode(bench.questions[0].question_id)

    Attributes:
        questions: The questions in order, with opaque names of sequences if these are used.
        sequences: The sequences by these names.
        observer: The pictures of the sequences in `observed`.
        folders: The folders of sequences with opaque names; None without.
        synthetic: Whether a question is about a sample world.
    """

    def __init__(self, store: Store, questions: Sequence[QuestionRow], image_root: str | None, opaque: bool) -> None:
        """Hold selected questions; `Bench.open` selects them first.

        Args:
            store: The store.
            questions: The questions.
            image_root: Folder with one folder of panoramas per sequence.
            opaque: Whether players get opaque names of sequences.

        Raises:
            StoreError: A question is about an unknown sequence.
        """
        known_sequences = read_sequences(store)
        if unknown := sorted({question.sequence for question in questions} - known_sequences.keys()):
            raise StoreError(f"questions are about {unknown[0][:120]!r}, which sequences.parquet lacks: generate again")
        names = opaque_names(store, known_sequences) if opaque else {name: name for name in known_sequences}
        self.sequences = {names[name]: replace(info, sequence=names[name]) for name, info in known_sequences.items()}
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
        """Select questions of a store.

        Args:
            store: The store, or its folder.
            questions: A selection or ids; by default all questions that have panoramas.
            limit: A maximum number of questions.
            images: Folder of panoramas in place of the folder that the store names.
            opaque: Whether players get opaque names of sequences.

        Returns:
            The bench.

        Raises:
            StoreError: A public file is missing, or no question remains.
            InputError: The selection has an unknown name.
        """
        store = Store.of(store)
        image_root = find_images(store, images)
        chosen = select_questions(read_question_rows(store), QuestionSelection.of(questions, limit), image_root)
        return cls(store, chosen, image_root, opaque)

    def question(self, question_id: str) -> Question:
        """Return a question by its id. Raise InputError if the id is unknown."""
        if question_id not in self._by_id:
            raise InputError(f"no question {question_id[:40]!r} among the {len(self.questions)}", field="question_id")
        return self._by_id[question_id]

    def task(
        self,
        question_id: str,
        record: Record = lambda step: None,
        record_write: RecordWrite = lambda write: None,
    ) -> Task:
        """Return the task of a question for a method.

        Args:
            question_id: The id of the question.
            record: Receives the steps of the method.
            record_write: Receives writes into a world model.

        Returns:
            The task.

        Raises:
            InputError: The id is unknown.
        """
        question = self.question(question_id)
        info = self.sequences[question.sequence]
        return Task(question, info, self.observer, self.observer.stored, record, record_write)

    def episode(self, question_id: str, *, budget: int = BUDGET, record: Record = lambda step: None) -> Episode:
        """Begin to play a question.

        Args:
            question_id: The id of the question.
            budget: The maximum number of looks.
            record: Receives the steps of the player.

        Returns:
            The episode.

        Raises:
            InputError: The id is unknown.
        """
        return Episode(self.task(question_id, record), budget=budget)


_LABELS_BESIDE: Final = ("image_stitched", "images")
"""Names of folders between panoramas and the root folder, which also holds the labels."""


def root_of_images(images: str | Path) -> Path:
    """Return the root folder of JRDB that holds a folder of panoramas; the folder itself if it is not part of one."""
    root = Path(images).resolve()
    for name in _LABELS_BESIDE:
        root = root.parent if root.name == name else root
    return root


def find_images(store: Store, images: str | Path | None) -> str | None:
    """Return the folder of panoramas.

    Args:
        store: The store.
        images: A folder in place of the folder that the store names.

    Returns:
        The folder; None if the store was loaded without panoramas.

    Raises:
        StoreError: The store has no manifest to name the folder.
    """
    if images is not None:
        return str(images)
    if store.question_path("questions").exists() and not (store.path / "store.json").exists():
        raise StoreError(f"{store.path} has no store.json, which names the panoramas: give their folder by --images")
    return store.manifest().image_root
