"""Select questions with four fixed answers, so that no answer is more frequent than others in any context.

For each context and each answer, X is three times the number of questions with that answer, minus the number of
questions with another one. The cost is the sum of the squares of X, each with the weight of its context, plus costs for
further questions of a person, a description and a sequence.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from jrdb_avr.engine.generate.asked import (
    Candidate,
    Question,
    Selected,
    Twins,
    doublings,
    keep_most,
    sequence_cap,
    sizes_of,
)
from jrdb_avr.engine.generate.guessers import JUDGED, Offer, above_bound
from jrdb_avr.engine.generate.hashes import hash_of
from jrdb_avr.engine.generate.near_duplicates import Taken
from jrdb_avr.schema.arrays import Ints

_MAX_ANSWER_PERCENT: Final = 31
"""Maximum share of one answer, in percent."""

_MAX_DESCRIBED: Final = 4
"""Maximum number of questions of the template presence with one description at one time."""

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


class _Rows:
    """The candidates of a template as arrays, in the order of their keys' hashes, and the state of the selection."""

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        self.candidates = sorted(candidates, key=lambda candidate: hash_of(candidate.key))
        count = len(self.candidates)
        self.number = {candidate.key: row for row, candidate in enumerate(self.candidates)}
        answers = sorted({candidate.truth for candidate in candidates})
        names = sorted({name for candidate in candidates for name, _ in candidate.contexts})
        numbers = {name: number for number, name in enumerate(names, 1)}
        most = max((len(candidate.contexts) for candidate in candidates), default=0)
        self.contexts, self.weights = np.zeros((2, count, most), np.int64)
        for row, candidate in enumerate(self.candidates):
            for index, (name, weight) in enumerate(candidate.contexts):
                self.contexts[row, index], self.weights[row, index] = numbers[name], weight
        self.answers = np.array([answers.index(candidate.truth) for candidate in self.candidates], np.int64)
        self.levels = np.zeros((len(names) + 1, len(answers)), np.int64)
        self.people = _numbered([candidate.moment[:2] for candidate in self.candidates])
        self.described = _numbered([(one.sequence, one.described) for one in self.candidates])
        self.sequences = _numbered([candidate.sequence for candidate in self.candidates])
        self.per = [np.zeros(count, np.int64) for _ in range(3)]

    def costs(self, rows: Ints) -> Ints:
        """Return by how much each row raises the cost."""
        levels = self.levels[self.contexts[rows], self.answers[rows, None]]
        costs: Ints = (self.weights[rows] * (8 * levels + 12)).sum(axis=1)
        for number, groups, cost in zip(self.per, self._groups, _GROUP_COSTS, strict=True):
            costs += cost * number[groups[rows]]
        return costs

    def add(self, row: int, sign: int = 1) -> None:
        """Add a row to the state, or remove it by the sign -1."""
        contexts = self.contexts[row][self.contexts[row] > 0]
        self.levels[contexts] -= sign
        self.levels[contexts, self.answers[row]] += 4 * sign
        for number, groups in zip(self.per, self._groups, strict=True):
            number[groups[row]] += sign

    @property
    def _groups(self) -> tuple[Ints, Ints, Ints]:
        return self.people, self.described, self.sequences


_GROUP_COSTS: Final = (_PERSON_COST, _DESCRIBED_COST, _SEQUENCE_COST)


def _numbered(values: Sequence[object]) -> Ints:
    """Return a number for each value; equal values have the same number."""
    numbers: dict[object, int] = {}
    return np.array([numbers.setdefault(value, len(numbers)) for value in values], np.int64)


def select_answers(
    candidates: Sequence[Candidate], quota: int, taken: Taken, sequences: int, twins: Sequence[Twins] = ()
) -> Selected:
    """Select the questions of a template with fixed answers, such as presence.

    Args:
        candidates: The proven candidates of the template, in any order.
        quota: Number of questions wanted.
        taken: Account of near-duplicates and caps of all templates. The selected questions are added.
        sequences: Number of sequences of the data.
        twins: Matched pairs of time twins, the best first.

    Returns:
        The selected questions. Their number is the largest share of the quota, in steps of 5 %, for which no counting
        guesser is above its bound.
    """
    cap = sequence_cap(quota, sequences, 10 if candidates and candidates[0].template == "presence" else 20)
    best: list[Question] = []
    shortage = None
    for size in [quota, *sizes_of(quota)]:
        if best and len(best) <= size:
            continue
        best = _attempt(candidates, size, taken.copy(), cap, ())
        guesser = above_bound([_offer(question) for question in best])
        if guesser is None:
            break
        shortage = f"of {size} questions a guesser would have too many right: {guesser}"

    def with_twins(count: int) -> list[Question] | None:
        paired = _attempt(candidates, size, taken.copy(), cap, twins[:count])
        return paired if above_bound([_offer(question) for question in paired]) is None else None

    best = keep_most(len(twins), with_twins) or best
    for question in best:
        taken.add(question.candidate.subject)
    if shortage is None and len(best) < quota:
        shortage = f"caps and the share of each answer leave {len(best)} of {len(candidates)} candidates"
    return Selected(best, shortage)


def _attempt(
    candidates: Sequence[Candidate], size: int, taken: Taken, cap: int, twins: Sequence[Twins]
) -> list[Question]:
    """Select greedily up to a size, then drop questions with too frequent answers."""
    rows = _Rows(candidates)
    alive = np.ones(len(candidates), bool)
    chosen: dict[int, Question] = {}

    def admits(row: int) -> bool:
        below = rows.per[1][rows.described[row]] < _MAX_DESCRIBED and rows.per[2][rows.sequences[row]] < cap
        return bool(below) and taken.admits(rows.candidates[row].subject)

    def put(row: int, twin: str | None = None) -> None:
        candidate = rows.candidates[row]
        chosen[row] = Question(candidate, tuple(sorted(candidate.wrong)), twin)
        rows.add(row)
        taken.add(candidate.subject)
        alive[row] = False

    for first, second in twins:
        pair = rows.number[first.key], rows.number[second.key]
        if len(chosen) + 2 <= size and admits(pair[0]) and not chosen.keys() & set(pair):
            put(pair[0], min(first.key, second.key))
            if admits(pair[1]):
                put(pair[1], min(first.key, second.key))
            else:
                rows.add(pair[0], -1)
                taken.remove(chosen.pop(pair[0]).candidate.subject)
    while len(chosen) < size and alive.any():
        free = np.flatnonzero(alive)
        for index in np.argsort(rows.costs(free), kind="stable"):
            row = int(free[index])
            if admits(row):
                put(row)
                break
            alive[row] = False
    _drop_frequent(rows, chosen)
    return [chosen[row] for row in sorted(chosen)]


def _drop_frequent(rows: _Rows, chosen: dict[int, Question]) -> None:
    """Drop the costliest questions with the most frequent answer until its share is within bounds; twins stay."""
    while len(chosen) >= JUDGED:
        numbers = Counter(question.candidate.truth for question in chosen.values())
        answer, number = min(numbers.items(), key=lambda item: (-item[1], item[0]))
        loose = [row for row, one in chosen.items() if one.candidate.truth == answer and one.twin is None]
        if 100 * number <= _MAX_ANSWER_PERCENT * len(chosen) or not loose:
            return
        worst = max(zip(rows.costs(np.array(loose)).tolist(), loose, strict=True))[1]
        rows.add(worst, -1)
        del chosen[worst]


def _offer(question: Question) -> Offer:
    return Offer(question.candidate.sequence, question.candidate.truth, question.wrong)
