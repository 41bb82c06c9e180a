"""Scores of a run that is in progress: sums of what the `Judge` says of each finished question.

Nothing of it reaches a method. Where there are no answers (a machine that has the public files alone), or anything is
wrong, nothing is reported.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from jrdb_avr.engine.run.journal import Finished
from jrdb_avr.engine.run.judge import Judge, QuestionScore
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError


@dataclass(frozen=True, slots=True)
class LiveScore:
    """Scores so far: the questions judged, and how many of them score."""

    judged: int
    answer: int
    evidence: int
    combined: int

    def __str__(self) -> str:
        words = (("answer", self.answer), ("evidence", self.evidence), ("combined", self.combined))
        return ", ".join(f"{word} {100 * n / max(self.judged, 1):.1f} %" for word, n in words) + f" of {self.judged}"


@contextlib.contextmanager
def report_scores(
    store: Store, before: Iterable[Finished], report: Callable[[LiveScore], None]
) -> Iterator[Callable[[Finished], None]]:
    """Call `report` with a run's scores whenever they change, from another thread, while the block lasts.

    `before`: what was finished earlier; yields a function that takes what finishes. The last entry of a question
    counts; an error scores nothing.
    """
    # Predictions alone: transcripts may be a hundred kilobytes each, and judging may fall behind.
    entries: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
    for entry in before:
        entries.put(entry.prediction)
    judges: list[Judge] = []

    def work() -> None:
        with contextlib.suppress(AvrError, OSError), Judge(store) as judge:
            judges.append(judge)
            scored: dict[str, QuestionScore] = {}
            last: LiveScore | None = None
            while (entry := entries.get()) is not None:
                scored[entry["question_id"]] = judge.score_row(entry)
                answer, evidence, combined, _ = map(sum, zip(*scored.values(), strict=True))
                score = LiveScore(len(scored), answer, evidence, combined)
                if score != last and entries.empty():
                    last = score
                    report(score)

    reader = threading.Thread(target=work, name="live scores", daemon=True)
    reader.start()
    try:
        yield lambda entry: entries.put(entry.prediction)
    finally:
        entries.put(None)
        for judge in judges:
            judge.close()
        reader.join(1.0)
