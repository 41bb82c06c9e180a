"""A run whose questions are played one move at a time, by somebody other than a method of this program."""

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
    """The bench and the run of a player; an interrupt ends it, and at the end the tables are written.

    Raises StoreError or InputError where store, run or selection do not fit.
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
    """The ids of the bench's questions that the run has not answered, in order."""
    return [own.question_id for own in unanswered(bench.questions, run.finished)]


@dataclass
class Play:
    """A question being played: its episode, the steps on record, and when it began."""

    episode: Episode
    steps: list[Step]
    started: float = field(default_factory=time.perf_counter)

    @classmethod
    def begin(cls, bench: Bench, question_id: str) -> Play:
        """Begin a question."""
        steps: list[Step] = []
        return cls(bench.episode(question_id, budget=BUDGET, record=lambda step: steps.append(step)), steps)

    def record(self, run: Run) -> None:
        """Add what was played to the run."""
        seconds = time.perf_counter() - self.started
        run.append(finished_entry(self.episode.question, self.episode.finished(), self.steps, (), seconds))
