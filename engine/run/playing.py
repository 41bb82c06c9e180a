"""Make the run of a player. A player answers questions move by move, and is a person or an external agent."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from jrdb_avr.agent.methods.episode import BUDGET, Episode
from jrdb_avr.engine.run.bench import Bench, find_images
from jrdb_avr.engine.run.evaluate import default_run_id
from jrdb_avr.engine.run.journal import finished_entry
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.run import Run, key_fingerprint, run_questions
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.method import Step


@contextlib.contextmanager
def played_run(
    store: Store,
    method: str,
    model: str,
    run_id: str | None = None,
    *,
    questions: QuestionSelection | None = None,
    limit: int | None = None,
    resume: bool = False,
    images: str | Path | None = None,
    opaque: bool = False,
) -> Iterator[tuple[Bench, Run]]:
    """Yield the bench and the run of a player. When the `with` block ends or is interrupted, write the run's tables.

    Args:
        store: The store.
        method: The name of the method in the manifest.
        model: The name of the player. The manifest stores it as the name of the model.
        run_id: The id of the run. Default: an id that is made of the names of the method and the player.
        questions: The selection of questions. None selects all questions.
        limit: Maximum number of questions. None sets no maximum.
        resume: Whether to continue the run if it exists.
        images: The folder of panoramas. Default: the folder that the store names.
        opaque: Whether to replace the names of sequences by opaque names.

    Yields:
        The bench and the run.

    Raises:
        StoreError: If no question is selected, if no selected question has panoramas, or if the run exists and cannot
            be resumed.
        InputError: If the selection names a question, family, template or sequence that the store lacks.
    """
    run_id = default_run_id(method, model) if run_id is None else run_id
    image_root = find_images(store, images)
    chosen, selection = run_questions(store, run_id, QuestionSelection.of(questions, limit), resume, image_root)
    bench = Bench(store, chosen, image_root, opaque)
    with Run(store, run_id) as run:
        settings = {"method": {"budget": BUDGET}, **({"opaque": key_fingerprint(store)} if opaque else {})}
        ids = [question.question_id for question in chosen]
        run.start(method, model, ids, settings, bench.synthetic, selection)
        with contextlib.suppress(KeyboardInterrupt):
            yield bench, run


@dataclass
class Play:
    """A question in progress: its episode, the recorded steps, and `time.perf_counter()` at the start of the play."""

    episode: Episode
    steps: list[Step]
    started: float = field(default_factory=time.perf_counter)

    @classmethod
    def begin(cls, bench: Bench, question_id: str) -> Play:
        """Return a new play of a question, before its first move."""
        steps: list[Step] = []
        return cls(bench.episode(question_id, budget=BUDGET, record=lambda step: steps.append(step)), steps)

    @property
    def question_id(self) -> str:
        """The id of the question."""
        return self.episode.question.question_id

    def record(self, run: Run) -> None:
        """Append the entry of the question to the journal of the run."""
        seconds = time.perf_counter() - self.started
        run.append(finished_entry(self.episode.question, self.episode.finished(), self.steps, (), seconds))
