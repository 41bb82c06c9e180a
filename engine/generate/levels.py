"""Level of the true choices, so that no choice is true more often than others.

The cost is a whole number. For each context of a question and each choice, X is the number of times that the choice is
offered as wrong, minus three times the number of times that it is true. For each ordered pair of choices offered
together, P is the same number for the first choice. For each ranking of the true choice, R is the number of questions
with each rank. The cost grows with the squares of X and P and with uneven R. Then come the number of questions per
person, description and sequence, and wrong choices that no person in the frame does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, NamedTuple, cast

import numpy as np

from jrdb_avr.engine.generate.asked import Candidate, Question, offer_of
from jrdb_avr.engine.generate.choices import wrong_sets
from jrdb_avr.engine.generate.guessers import LabelCounts
from jrdb_avr.engine.report.hashes import hash_of, permute
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.choice_labels import CHOICE_LABELS
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS


class _Weights(NamedTuple):
    """Weights of the cost, and the maximum number of questions with one description at one time."""

    pair: int
    ranks: tuple[int, int, int]
    person: int
    described: int
    sequence: int
    doing: int
    max_described: float


_ACTIONS: Final = _Weights(20, (3, 4, 4), person=60, described=0, sequence=3, doing=10, max_described=float("inf"))
_ANSWERS: Final = _Weights(0, (0, 0, 0), person=160, described=160, sequence=8, doing=0, max_described=4)

_SHARES: Final = np.array([-3, 1, 1, 1])
"""What a question adds to X for its true choice and its three wrong choices."""

_LABELS: Final = (*CHOICE_LABELS, *PRESENCE_ANSWERS, *DISTANCE_ANSWERS)
_CODE: Final = {label: number for number, label in enumerate(_LABELS)}

_CODES: Final = len(_LABELS)
_BASE: Final = np.array([_CODES * _CODES, _CODES, 1])
"""Factors that make one number of three codes of choices."""

_RANK_BASE: Final = np.array([16, 4, 1])
"""Factors that make one number of three ranks."""


@dataclass(frozen=True, slots=True)
class _Options:
    """The possible choices of a candidate, in the order of a hash.

    Attributes:
        true: Code of the true choice.
        wrong: Codes of three wrong choices (options, 3).
        triple: The three codes as one number, the index of a cost of their pairs (options).
        rank: The three ranks of the true choice as one number, the index of a cost of ranks (options).
        base: What each option costs whatever is selected (options).
        contexts: Number of each context; 0 is none (contexts).
        weights: Weight of each context (contexts).
    """

    candidate: Candidate
    true: int
    wrong: Ints
    triple: Ints
    rank: Ints
    base: Ints
    contexts: Ints
    weights: Ints


class Level:
    """State of the selected questions of a template with choices.

    A level knows by how much each further question raises the cost.

    Attributes:
        fixed: Whether all questions have the same four choices.
        of_sequence: Number of questions of each sequence.
    """

    def __init__(self, candidates: Iterable[Candidate], counts: LabelCounts) -> None:
        """Make the level of a template. No question is selected yet."""
        candidates = list(candidates)
        names = {name for candidate in candidates for name, _ in candidate.contexts}
        self.fixed = not any(candidate.truth in CHOICE_LABELS for candidate in candidates)
        self._weights = _ANSWERS if self.fixed else _ACTIONS
        self._counts = counts
        self._contexts = {name: number for number, name in enumerate(sorted(names), 1)}
        self._most = max((len(candidate.contexts) for candidate in candidates), default=0)
        self._options: dict[str, _Options] = {}
        self._levels = np.zeros((len(names) + 1, len(_LABELS)), np.int64)
        self._pairs = np.zeros((len(_LABELS), len(_LABELS)), np.int64)
        self._ranks = np.zeros((3, 4), np.int64)
        self._people: Counter[object] = Counter()
        self._described: Counter[object] = Counter()
        self.of_sequence: Counter[str] = Counter()
        self._shared: tuple[Ints, Ints, Ints] | None = None

    def add(self, question: Question, sign: int = 1) -> None:
        """Add a question to the state, or remove it by the sign -1."""
        candidate = question.candidate
        labels = np.array([_CODE[label] for label in (candidate.truth, *question.wrong)])
        np.add.at(self._levels, (self._options_of(candidate).contexts[:, None], labels), sign * _SHARES)
        for label, share in zip(labels.tolist(), _SHARES.tolist(), strict=True):
            self._pairs[label, labels[labels != label]] += sign * share
        ranks = offer_of(question, self._counts).ranks
        self._ranks[np.arange(len(ranks)), list(ranks)] += sign
        self._people[candidate.person] += sign
        self._described[candidate.sequence, candidate.described] += sign
        self.of_sequence[candidate.sequence] += sign
        self._shared = None

    def allows(self, candidate: Candidate) -> bool:
        """Return whether a further question may have the candidate's description."""
        return self._described[candidate.sequence, candidate.described] < self._weights.max_described

    def cheapest(self, candidates: Sequence[Candidate]) -> tuple[int, Question]:
        """Find the question that raises the cost least.

        Args:
            candidates: Candidates with at least three wrong choices. Of equals the first one is taken.

        Returns:
            The increase of the cost, and the question.
        """
        rows = [self._options_of(candidate) for candidate in candidates]
        costs = self._costs(rows)
        index, ends = int(costs.argmin()), np.cumsum([len(row.base) for row in rows])
        row = int(np.searchsorted(ends, index, side="right"))
        wrong = sorted(_LABELS[code] for code in rows[row].wrong[index - ends[row]].tolist())
        return int(costs[index]), Question(candidates[row], tuple(wrong))

    def costs_of(self, questions: Iterable[Question]) -> list[int]:
        """Return by how much each question raises the cost."""
        rows = []
        for question in questions:
            options = self._options_of(question.candidate)
            codes = sorted(_CODE[label] for label in question.wrong)
            (index,) = np.flatnonzero((options.wrong == codes).all(axis=1))
            parts = {name: getattr(options, name)[[index]] for name in ("wrong", "triple", "rank", "base")}
            rows.append(replace(options, **parts))
        return cast(list[int], self._costs(rows).tolist())

    def _options_of(self, candidate: Candidate) -> _Options:
        """Return the possible choices of a candidate, from memory if they were asked for before."""
        if candidate.key not in self._options:
            self._options[candidate.key] = self._make_options(candidate)
        return self._options[candidate.key]

    def _make_options(self, candidate: Candidate) -> _Options:
        sequence, frame = candidate.sequence, candidate.asked[-1]
        wrong = _coded_triples(candidate.wrong)
        wrong = wrong[np.argsort(permute((wrong @ _BASE).astype(np.uint64), hash_of(candidate.key)))]
        doing = np.isin(wrong, [_CODE[x] for x in self._counts.doing(sequence, frame) if x in _CODE])
        orders = self._counts.orders(sequence, frame)
        places = np.array([[order.get(label, 0) for label in _LABELS] for order in orders])
        true = _CODE[candidate.truth]
        ranks = (places[:, wrong] < places[:, true, None, None]).sum(axis=2)
        numbers, weights = np.zeros((2, self._most), np.int64)
        for index, (name, weight) in enumerate(candidate.contexts):
            numbers[index], weights[index] = self._contexts[name], weight
        # What one question costs by itself: squares of its own shares, and of its own ranks.
        own = int(_SHARES @ _SHARES) * (int(weights.sum()) + 3 * self._weights.pair) + 12 * sum(self._weights.ranks)
        base = own - self._weights.doing * doing.sum(axis=1)
        return _Options(candidate, true, wrong, wrong @ _BASE, _RANK_BASE @ ranks, base, numbers, weights)

    def _costs(self, rows: Sequence[_Options]) -> Ints:
        """Return by how much each option of some candidates raises the cost (sum of their options)."""
        own, candidates = self._weights, [row.candidate for row in rows]
        true = np.array([row.true for row in rows])
        weights = np.stack([row.weights for row in rows])
        levels = (self._levels[np.stack([row.contexts for row in rows])] * weights[..., None]).sum(axis=1)
        # (X + share)^2 - X^2 = 2 * X * share + share^2, and the last term is in `base`; likewise for P.
        fixed = -6 * levels[np.arange(len(rows)), true]
        fixed += [own.person * self._people[candidate.person] for candidate in candidates]
        fixed += [own.described * self._described[candidate.sequence, candidate.described] for candidate in candidates]
        fixed += [own.sequence * self.of_sequence[candidate.sequence] for candidate in candidates]
        pairs, triples, ranked = self._shared = self._shared or self._share_costs()
        single = 2 * levels + pairs[true]
        sizes = [len(row.base) for row in rows]
        shift = np.repeat(np.arange(len(rows)) * _CODES, sizes)
        wrong, triple, rank, base = (
            np.concatenate([getattr(row, name) for row in rows]) for name in ("wrong", "triple", "rank", "base")
        )
        costs = base + np.repeat(fixed, sizes) + triples[triple] + ranked[rank]
        return cast(Ints, costs + single.ravel()[wrong + shift[:, None]].sum(axis=1))

    def _share_costs(self) -> tuple[Ints, Ints, Ints]:
        """Return the costs of a wrong choice beside a true one, of the pairs of three wrong ones, and of ranks."""
        own = self._weights
        both = 2 * own.pair * (self._pairs + self._pairs.T)
        triples = (both[:, :, None] + both[:, None] + both).ravel()
        uneven = 8 * (4 * self._ranks - self.of_sequence.total()) * np.array(own.ranks)[:, None]
        ranked = (uneven[0][:, None, None] + uneven[1][:, None] + uneven[2]).ravel()
        return 2 * own.pair * (self._pairs.T - 3 * self._pairs), triples, ranked


@lru_cache(maxsize=4096)
def _coded_triples(wrong: frozenset[str]) -> Ints:
    """Return codes of the sets of three wrong choices, each in ascending order (sets, 3)."""
    return np.sort(np.array([[_CODE[x] for x in triple] for triple in wrong_sets(wrong)], np.int64).reshape(-1, 3))
