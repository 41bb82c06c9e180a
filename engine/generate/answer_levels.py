"""Level the answers of questions with four fixed answers, so that no answer is more frequent in any context.

For each context and each answer, X is three times the number of questions with that answer, minus the number of
questions with another one. The cost is the sum of the squares of X, each with the weight of its context, plus costs for
further questions of a person, a description and a sequence.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from jrdb_avr.engine.generate.asked import Candidate, Question, doublings

_MAX_DESCRIBED: Final = 4
"""Maximum number of questions with one description at one time."""

_PERSON_COST: Final = 160
_DESCRIBED_COST: Final = 160
_SEQUENCE_COST: Final = 8

_PARTS: Final = 4
"""Times in a sequence are compared by its quarters."""


def answer_contexts(
    sequence: str, frames: int, described: int, asked: Sequence[int], conditions: Iterable[str]
) -> tuple[tuple[str, int], ...]:
    """List the contexts of a question with fixed answers.

    Args:
        sequence: Name of the sequence.
        frames: Number of frames of the sequence.
        described: Frame of the description.
        asked: Frames asked about, ascending, without the frame of the description.
        conditions: Words of each condition of the description.

    Returns:
        The name and the weight of each context.
    """
    times = (described, *asked)
    waits = tuple(doublings(later - time) for time, later in zip(times, asked, strict=False))
    words = sorted(set(conditions))
    contexts = [("all", 10), (f"sequence {sequence}", 7), (f"waits {waits}", 7)]
    for number, wait in enumerate(waits):
        contexts += [(f"wait {number} {wait}", 7), (f"sequence {sequence} wait {number} {wait}", 4)]
    contexts.append((f"end {min(_PARTS - 1, _PARTS * (frames - asked[-1]) // max(1, frames))}", 4))
    contexts.append((f"left {doublings(frames - asked[0])} wait {waits[0]}", 4))
    contexts.append((f"described {min(_PARTS - 1, _PARTS * described // max(1, frames))}", 4))
    contexts.append((f"conditions {len(words)}", 3))
    return (*contexts, *((f"condition {word}", 3) for word in words))


class AnswerLevel:
    """Level of a template with four fixed answers. See `levelling.Level`."""

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        """Number the contexts, answers and groups of all candidates of a template that may be selected."""
        names = {name: number for number, name in enumerate(sorted({n for one in candidates for n, _ in one.contexts}))}
        answers = sorted({one.truth for one in candidates})
        self._row = {one.key: row for row, one in enumerate(candidates)}
        most = max(len(one.contexts) for one in candidates)
        self._contexts, self._weights = np.zeros((2, len(candidates), most), np.int64)
        for row, one in enumerate(candidates):
            self._contexts[row, : len(one.contexts)] = [names[name] for name, _ in one.contexts]
            self._weights[row, : len(one.contexts)] = [weight for _, weight in one.contexts]
        self._answers = np.array([answers.index(one.truth) for one in candidates])
        self._levels = np.zeros((len(names), len(answers)), np.int64)
        self._people: Counter[object] = Counter()
        self._described: Counter[object] = Counter()
        self.of_sequence: Counter[str] = Counter()

    def add(self, question: Question, sign: int = 1) -> None:
        """Add a question to the state, or remove it by the sign -1."""
        one, row = question.candidate, self._row[question.candidate.key]
        contexts = self._contexts[row, : len(one.contexts)]
        self._levels[contexts] -= sign
        self._levels[contexts, self._answers[row]] += 4 * sign
        self._people[one.moment[:2]] += sign
        self._described[one.sequence, one.described] += sign
        self.of_sequence[one.sequence] += sign

    def allows(self, candidate: Candidate) -> bool:
        """Return whether a further question may have the candidate's description."""
        return self._described[candidate.sequence, candidate.described] < _MAX_DESCRIBED

    def cheapest(self, candidates: Sequence[Candidate]) -> tuple[int, Question]:
        """Find the question that raises the cost least. Of equals the first one is taken."""
        rows = np.array([self._row[one.key] for one in candidates])
        # X of the answer grows by three, and X of each other answer falls by one.
        levels = self._levels[self._contexts[rows], self._answers[rows, None]]
        costs = (self._weights[rows] * (8 * levels + 12)).sum(axis=1)
        costs += _PERSON_COST * np.array([self._people[one.moment[:2]] for one in candidates])
        costs += _DESCRIBED_COST * np.array([self._described[one.sequence, one.described] for one in candidates])
        costs += _SEQUENCE_COST * np.array([self.of_sequence[one.sequence] for one in candidates])
        best = candidates[index := int(costs.argmin())]
        return int(costs[index]), Question(best, tuple(sorted(best.wrong)))

    def cost_of(self, question: Question) -> int:
        """Return by how much a question raises the cost."""
        return self.cheapest([question.candidate])[0]
