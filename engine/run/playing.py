"""Play the questions of a run one move at a time, by a person or an agent outside this program."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from jrdb_avr.agent.methods.episode import BUDGET, Episode
from jrdb_avr.engine.run.bench import Bench, find_images
from jrdb_avr.engine.run.journal import finished_entry, unanswered
from jrdb_avr.engine.run.opaque import key_fingerprint
from jrdb_avr.engine.run.options import QuestionSelection
from jrdb_avr.engine.run.run import Run, run_questions
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.method import Step


@contextlib.contextmanager
def played_run(
    store: Store,
    method: str,
    model: str,
    run_id: str,
    *,
    questions: QuestionSelection | None = None,
    limit: int | None = None,
    resume: bool = False,
    images: str | Path | None = None,
    opaque: bool = False,
) -> Iterator[tuple[Bench, Run]]:
    """Yield the bench and the run of a player. An interrupt ends the block, and the tables are written at its end.

    Args:
        store: The store.
        method: The method of the run.
        model: The player, as the model of the run.
        run_id: The id of the run.
        questions: The selection of the questions.
        limit: A maximum number of questions.
        resume: Whether the run may exist.
        images: Folder of panoramas in place of the folder that the store names.
        opaque: Whether the player gets opaque names of sequences.

    Yields:
        The bench and the run.

    Raises:
        StoreError: The store or the run does not fit.
        InputError: The selection does not fit.
    """
    image_root = find_images(store, images)
    chosen, selection = run_questions(store, run_id, QuestionSelection.of(questions, limit), resume, image_root)
    bench = Bench(store, chosen, image_root, opaque)
    with Run(store, run_id) as run:
        settings = {"method": {"budget": BUDGET}, **({"opaque": key_fingerprint(store)} if opaque else {})}
        ids = [question.question_id for question in chosen]
        run.start(method, model, ids, settings, bench.synthetic, selection)
        try:
            yield bench, run
        except KeyboardInterrupt:
            pass
        finally:
            if run.finished:
                run.finish()


def due_questions(bench: Bench, run: Run) -> list[str]:
    """Return the ids of questions that the run has not answered, in order."""
    return [question.question_id for question in unanswered(bench.questions, run.finished)]


@dataclass
class Play:
    """A question in progress: its episode, its recorded steps, and its start time."""

    episode: Episode
    steps: list[Step]
    started: float = field(default_factory=time.perf_counter)

    @classmethod
    def begin(cls, bench: Bench, question_id: str) -> Play:
        """Begin a question."""
        steps: list[Step] = []
        return cls(bench.episode(question_id, budget=BUDGET, record=lambda step: steps.append(step)), steps)

    def record(self, run: Run) -> None:
        """Add the question to the run."""
        seconds = time.perf_counter() - self.started
        run.append(finished_entry(self.episode.question, self.episode.finished(), self.steps, (), seconds))
