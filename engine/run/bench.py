"""Hand out the questions and pictures of a store as tasks and episodes. Only public files of the store are read.

Predictions are scored by the module `judge`, which reads the private files: answers and evidence.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from jrdb_avr.agent.methods.episode import BUDGET, Episode
from jrdb_avr.agent.model.messages import jpeg_picture
from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.selection import select_questions
from jrdb_avr.queries.manifest import MANIFEST_NAME
from jrdb_avr.queries.opaque import opaque_ids, opaque_names
from jrdb_avr.queries.questions import QuestionRow, read_question_rows, read_sequences
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.card import is_of_sample
from jrdb_avr.schema.errors import InputError, StoreError, warn
from jrdb_avr.schema.method import Question, Record, RecordWrite, Task
from jrdb_avr.schema.panorama import HEIGHT, WIDTH


class Bench:
    """Questions of a store with their pictures, for methods, people and agents. Many threads may share a bench.

        bench = Bench("store")
        episode = bench.episode(bench.questions[0].question_id)

    Attributes:
        questions: The selected questions. If names are opaque, so are their ids and the names of their sequences.
        sequences: All sequences of the store, by name. If names are opaque, the keys are the opaque names.
        observed: The sequences of the questions in `questions`, sorted by real name.
        observer: The source of the pictures of the sequences in `observed`.
        folders: The real name of each sequence in `observed`, by opaque name. None if names are not opaque.
        synthetic: Whether at least one question is about the sample world.
    """

    def __init__(
        self,
        store: Store | str | Path,
        questions: Sequence[QuestionRow] | None = None,
        image_root: str | None = None,
        opaque: bool = False,
    ) -> None:
        """Hold all questions that have panoramas, or given rows. To select questions, call `Bench.open`.

        Args:
            store: The store, or its folder.
            questions: The rows of the questions.
            image_root: The folder that has one folder of panoramas per sequence. It belongs to `questions`.
            opaque: Whether to replace the names of sequences by opaque names.

        Raises:
            StoreError: If the store does not list the sequence of a question.
        """
        store = Store.of(store)
        if questions is None:
            image_root = find_images(store, None)
            questions = select_questions(read_question_rows(store), QuestionSelection(), image_root)
        known_sequences = read_sequences(store)
        if unknown := sorted({question.sequence for question in questions} - known_sequences.keys()):
            raise StoreError(f"questions are about {unknown[0][:120]!r}, which sequences.parquet lacks: generate again")
        names = opaque_names(store, known_sequences) if opaque else {name: name for name in known_sequences}
        self.sequences = {names[name]: replace(info, sequence=names[name]) for name, info in known_sequences.items()}
        ids = opaque_ids(store, (row.question_id for row in questions)) if opaque else {}
        self.questions = [
            replace(q.to_question(), question_id=ids.get(q.question_id, q.question_id), sequence=names[q.sequence])
            for q in questions
        ]
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
        """Select questions of a store, and return their bench.

        Args:
            store: The store, or its folder.
            questions: A selection, or the ids of questions. Default: all questions that have panoramas.
            limit: Maximum number of questions. None sets no maximum.
            images: The folder of panoramas. Default: the folder that the store names.
            opaque: Whether to replace the names of sequences by opaque names.

        Returns:
            The bench.

        Raises:
            StoreError: If a public file is missing, or if no question is selected.
            InputError: If the selection names a question, family, template or sequence that the store lacks.
        """
        store = Store.of(store)
        image_root = find_images(store, images)
        chosen = select_questions(read_question_rows(store), QuestionSelection.of(questions, limit), image_root)
        return cls(store, chosen, image_root, opaque)

    def question(self, question_id: str) -> Question:
        """Return the question with the given id. Raise InputError if the bench has no question with this id."""
        if question_id not in self._by_id:
            raise InputError(f"no question {question_id[:40]!r} among the {len(self.questions)}", field="question_id")
        return self._by_id[question_id]

    def task(
        self,
        question_id: str,
        record: Record = lambda step: None,
        record_write: RecordWrite = lambda write: None,
    ) -> Task:
        """Return the task that a method gets for a question.

        Args:
            question_id: The id of the question.
            record: Called with each step that the method records.
            record_write: Called with each write to the world model that the method records.

        Returns:
            The task.

        Raises:
            InputError: If the bench has no question with this id.
        """
        question = self.question(question_id)
        info = self.sequences[question.sequence]
        return Task(question, info, self.observer, self.observer.stored, record, record_write)

    def episode(self, question_id: str, *, budget: int = BUDGET, record: Record = lambda step: None) -> Episode:
        """Return a new episode, so that a player can answer a question move by move.

        Args:
            question_id: The id of the question.
            budget: Maximum number of looks.
            record: Called with each step of the episode.

        Returns:
            The episode, before its first move.

        Raises:
            InputError: If the bench has no question with this id.
        """
        return Episode(self.task(question_id, record), budget=budget)


_GREY: Final = 105
"""Grey level of the pictures of sequences without panoramas."""


def find_images(store: Store, images: str | Path | None) -> str | None:
    """Return the folder of panoramas.

    Args:
        store: The store.
        images: The folder that the user named, or None.

    Returns:
        `images` if it is not None, otherwise the folder that the store names. None if the store has no panoramas.

    Raises:
        StoreError: If `images` is None and the store has no manifest, which would name the folder.
    """
    if images is not None:
        return str(images)
    if store.question_path("questions").exists() and not (store.path / "store.json").exists():
        raise StoreError(f"{store.path} has no store.json, which names the panoramas: give their folder by --images")
    return store.manifest().image_root


@contextlib.contextmanager
def with_grey_pictures(store: Store, image_root: str | None, simulated: bool) -> Iterator[str | None]:
    """Yield a folder of panoramas. For simulated runs, each sequence that has only annotations has grey ones in it.

    Args:
        store: The store.
        image_root: The folder that has one folder of panoramas per sequence, or None.
        simulated: Whether the run is simulated.

    Yields:
        `image_root` itself if the run is not simulated or no sequence lacks panoramas, otherwise a temporary folder.
    """
    infos = read_sequences(store)
    # No file can exist below the null device.
    folders = {name: Path(image_root or os.devnull, name).resolve() for name in infos}
    annotated = store.manifest().sequences if simulated and (store.path / MANIFEST_NAME).exists() else {}
    lacking = [name for name in infos if name in annotated and not any(folders[name].glob("*.jpg"))]
    if not lacking:
        yield image_root
        return
    shown = f"{len(lacking)} of {len(infos)} sequences have no panoramas"
    warn(f"{shown}: the simulated model gets grey pictures of them")
    with tempfile.TemporaryDirectory() as folder:
        grey = Path(folder, "grey.jpg")
        grey.write_bytes(jpeg_picture("grey", np.full((HEIGHT, WIDTH, 3), _GREY, np.uint8), {}).data)
        for name in infos:
            if name not in lacking:
                Path(folder, name).symlink_to(folders[name])
                continue
            Path(folder, name).mkdir()
            for frame in infos[name].frames:
                Path(folder, name, f"{frame:06d}.jpg").symlink_to(grey)
        yield folder
