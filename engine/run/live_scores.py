"""Compute the scores of a run while it is in progress. `Judge` scores each finished question.

The scores never reach the method. If the store has no answers, no scores are reported. If scoring fails later, no
further scores are reported.
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
    """Scores of a run in progress, as counts of questions.

    Attributes:
        judged: Number of questions that have been scored so far.
        answer: Number of these questions with the answer score 1.
        evidence: Number of these questions with the evidence score 1.
        combined: Number of these questions with the combined score 1.
    """

    judged: int
    answer: int
    evidence: int
    combined: int

    def __str__(self) -> str:
        parts = (("answer", self.answer), ("evidence", self.evidence), ("combined", self.combined))
        return ", ".join(f"{word} {100 * n / max(self.judged, 1):.1f} %" for word, n in parts) + f" of {self.judged}"


@contextlib.contextmanager
def report_scores(
    store: Store, before: Iterable[Finished], report: Callable[[LiveScore], None]
) -> Iterator[Callable[[Finished], None]]:
    """Score the questions of a run in another thread while the `with` block runs.

    Args:
        store: The store, which has the answers.
        before: Entries of the questions that finished before the block began.
        report: Function that is called from the other thread each time the scores change, with the scores so far.

    Yields:
        A function that the block must call with the entry of each finished question. If a question has several
        entries, the last entry counts.
    """
    # The queue may grow if judging is slow. So it holds predictions without transcripts, because these are large.
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
