"""Level the actions that are choices, so that no action is true more often than others.

The cost is a whole number. For each context of a question and each action, X is the number of times that the action is
offered as wrong, minus three times the number of times that it is true. For each ordered pair of actions offered
together, P is the same number for the first action. For each ranking of the true choice, R is the number of questions
with each rank. The cost grows with the squares of X and P and with uneven R. Then come the number of questions
per person and sequence, and wrong choices that no person in the frame does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from jrdb_avr.engine.generate.asked import Candidate, Question, offer_of
from jrdb_avr.engine.generate.choices import wrong_sets
from jrdb_avr.engine.generate.guessers import LabelCounts
from jrdb_avr.engine.generate.hashes import hash_of, permute
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.choice_labels import CHOICE_LABELS

_PAIR_WEIGHT: Final = 20
_RANK_WEIGHTS: Final = (3, 4, 4)
_PERSON_COST: Final = 60
_SEQUENCE_COST: Final = 3
_DOING_GAIN: Final = 10

_PASSES: Final = 7
"""Maximum number of passes over all questions in `level_choices`."""

_SHARES: Final = np.array([-3, 1, 1, 1])
"""What a question adds to X for its true choice and its three wrong choices."""

_CODE: Final = {label: number for number, label in enumerate(CHOICE_LABELS)}


@dataclass(frozen=True, slots=True)
class _Options:
    """The possible choices of a candidate, in the order of a hash.

    Attributes:
        labels: Codes of the true choice and of three wrong choices (options, 4).
        ranks: Ranks of the true choice (options, 3).
        base: What each option costs whatever is selected (options).
        contexts: Number of each context; 0 is none (contexts).
        weights: Weight of each context (contexts).
    """

    candidate: Candidate
    labels: npt.NDArray[np.int8]
    ranks: npt.NDArray[np.int8]
    base: Ints
    contexts: Ints
    weights: Ints


class ChoiceLevel:
    """Level of a template with actions as choices. See `levelling.Level`."""

    def __init__(self, candidates: Iterable[Candidate], counts: LabelCounts) -> None:
        """Number the contexts of all candidates of a template that may be selected."""
        ordered = sorted(candidates, key=lambda candidate: candidate.key)
        names = {name for candidate in ordered for name, _ in candidate.contexts}
        self.counts = counts
        self._contexts = {name: number for number, name in enumerate(sorted(names), 1)}
        self._most = max((len(candidate.contexts) for candidate in ordered), default=0)
        self._options: dict[str, _Options] = {}
        labels = len(CHOICE_LABELS)
        self._levels = np.zeros((len(names) + 1, labels), np.int64)
        self._pairs = np.zeros((labels, labels), np.int64)
        self._ranks = np.zeros((len(_RANK_WEIGHTS), 4), np.int64)
        self._count = 0
        self.of_person: Counter[tuple[str, int]] = Counter()
        self.of_sequence: Counter[str] = Counter()

    def add(self, question: Question, sign: int = 1) -> None:
        """Add a question to the state, or remove it by the sign -1."""
        options = self._options_of(question.candidate)
        labels = np.array([_CODE[label] for label in (question.candidate.truth, *question.wrong)])
        np.add.at(self._levels, (options.contexts[:, None], labels), sign * _SHARES)
        for label, share in zip(labels.tolist(), _SHARES.tolist(), strict=True):
            self._pairs[label, labels[labels != label]] += sign * share
        ranks = offer_of(question, self.counts).ranks
        self._ranks[np.arange(len(ranks)), list(ranks)] += sign
        self._count += sign
        self.of_person[question.candidate.moment[:2]] += sign
        self.of_sequence[question.candidate.sequence] += sign

    def allows(self, candidate: Candidate) -> bool:
        """Return True, because the choices of each candidate can be levelled."""
        return True

    def cheapest(self, candidates: Sequence[Candidate]) -> tuple[int, Question]:
        """Find the question that raises the cost least.

        Args:
            candidates: Candidates with at least three wrong choices. Of equals the first one is taken.

        Returns:
            The increase of the cost, and the question.
        """
        rows = [self._options_of(candidate) for candidate in candidates]
        costs = self._costs(rows)
        index = int(costs.argmin())
        increase, row = int(costs[index]), 0
        while index >= len(rows[row].base):
            index -= len(rows[row].base)
            row += 1
        wrong = tuple(CHOICE_LABELS[code] for code in sorted(rows[row].labels[index, 1:].tolist(), key=_lexical))
        return increase, Question(candidates[row], wrong)

    def cost_of(self, question: Question) -> int:
        """Return by how much a question raises the cost."""
        options = self._options_of(question.candidate)
        codes = {_CODE[label] for label in question.wrong}
        (index,) = (row for row, labels in enumerate(options.labels[:, 1:].tolist()) if set(labels) == codes)
        return int(self._costs([options])[index])

    def _options_of(self, candidate: Candidate) -> _Options:
        """Return the possible choices of a candidate, from memory if they were asked for before."""
        options = self._options.get(candidate.key)
        if options is None:
            options = self._options[candidate.key] = self._make_options(candidate)
        return options

    def _make_options(self, candidate: Candidate) -> _Options:
        sequence, frame = candidate.sequence, candidate.asked[-1]
        wrong = _coded_triples(candidate.wrong)
        labels = np.hstack([np.full((len(wrong), 1), _CODE[candidate.truth], np.int8), wrong])
        labels = labels[np.argsort(permute(labels[:, 1:].astype(np.uint64) @ _BASE, hash_of(candidate.key)))]
        doing = np.isin(labels[:, 1:], [_CODE[x] for x in self.counts.doing(sequence, frame) if x in _CODE])
        orders = self.counts.orders(sequence, frame)
        places = np.array([[order[label] for label in CHOICE_LABELS] for order in orders])[:, labels]
        ranks = (places[..., 1:] < places[..., :1]).sum(axis=2).T.astype(np.int8)
        numbers, weights = np.zeros((2, self._most), np.int64)
        for index, (name, weight) in enumerate(candidate.contexts):
            numbers[index], weights[index] = self._contexts[name], weight
        # What one question costs by itself: squares of its own shares, and of its own ranks.
        own = int(_SHARES @ _SHARES) * int(weights.sum()) + 12 * sum(_RANK_WEIGHTS)
        own += _PAIR_WEIGHT * 3 * int(_SHARES @ _SHARES)
        return _Options(candidate, labels, ranks, own - _DOING_GAIN * doing.sum(axis=1), numbers, weights)

    def _costs(self, rows: Sequence[_Options]) -> Ints:
        """Return by how much each option of some candidates raises the cost (sum of their options)."""
        people = [_PERSON_COST * self.of_person[row.candidate.moment[:2]] for row in rows]
        others = [_SEQUENCE_COST * self.of_sequence[row.candidate.sequence] for row in rows]
        which = np.repeat(np.arange(len(rows)), [len(row.base) for row in rows])
        labels, ranks, costs = (
            np.concatenate([getattr(row, name) for row in rows]) for name in ("labels", "ranks", "base")
        )
        costs += np.add(people, others)[which]
        weights = np.stack([row.weights for row in rows])
        levels = (self._levels[np.stack([row.contexts for row in rows])] * weights[..., None]).sum(axis=1)
        # (X + share)^2 - X^2 = 2 * X * share + share^2, and the last term is in `base`; likewise for P.
        true, first, second, third = labels.T
        costs += 2 * (levels[which[:, None], labels] @ _SHARES)
        beside = self._pairs.T - 3 * self._pairs
        both = self._pairs + self._pairs.T
        pairs = beside[true, first] + beside[true, second] + beside[true, third]
        pairs += both[first, second] + both[first, third] + both[second, third]
        costs += 2 * _PAIR_WEIGHT * pairs
        uneven = 8 * (4 * self._ranks - self._count) * np.array(_RANK_WEIGHTS)[:, None]
        costs += uneven[np.arange(len(_RANK_WEIGHTS)), ranks].sum(axis=1)
        return costs


def _lexical(code: int) -> str:
    return CHOICE_LABELS[code]


_BASE: Final = np.array([1, 64, 64 * 64], np.uint64)
"""Factors that make one number of three codes of actions."""


@lru_cache(maxsize=4096)
def _coded_triples(wrong: frozenset[str]) -> npt.NDArray[np.int8]:
    """Return codes of the sets of three wrong choices (sets, 3)."""
    return np.array([[_CODE[x] for x in triple] for triple in wrong_sets(wrong)], np.int8).reshape(-1, 3)


def level_choices(candidates: Sequence[Candidate], counts: LabelCounts) -> list[Question]:
    """Choose the wrong choices of all candidates of a template, without leaving any out.

    Args:
        candidates: The candidates that have choices, in any order.
        counts: How common actions are.

    Returns:
        A question per candidate with at least three wrong choices, in the order of their keys.
    """
    level = ChoiceLevel(candidates, counts)
    ordered = sorted((x for x in candidates if wrong_sets(x.wrong)), key=lambda candidate: candidate.key)
    chosen: dict[str, Question] = {}
    for turn in range(_PASSES):
        moved = False
        for candidate in ordered:
            question = chosen.get(candidate.key)
            if question:
                level.add(question, -1)
            cost, better = level.cheapest([candidate])
            if question is None or cost < level.cost_of(question):
                chosen[candidate.key], moved = better, True
            level.add(chosen[candidate.key])
        if turn and not moved:
            break
    return [chosen[candidate.key] for candidate in ordered]
