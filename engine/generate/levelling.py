"""Select questions and their wrong choices together, so that no choice is true more often than others.

The cost is a whole number. For each context of a question and each action, X is the number of times that the action is
offered as wrong, minus three times the number of times that it is true. For each ordered pair of actions offered
together, P is the same number for the first action. For each ranking of the true choice, R is the number of questions
with each rank. The cost grows with the squares of X and P and with uneven R. Then come the number of questions
per person and sequence, and wrong choices that no person in the frame does.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from jrdb_avr.engine.generate.asked import (
    Candidate,
    Question,
    Selected,
    Twins,
    keep_most,
    moment_hash,
    offer_of,
    sequence_cap,
    sizes_of,
)
from jrdb_avr.engine.generate.choices import wrong_sets
from jrdb_avr.engine.generate.guessers import LabelCounts, Offer, above_bound
from jrdb_avr.engine.generate.hashes import hash_of, permute
from jrdb_avr.engine.generate.near_duplicates import Taken
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.choice_labels import CHOICE_LABELS

_PAIR_WEIGHT: Final = 20
_RANK_WEIGHTS: Final = (3, 4, 4)
_PERSON_COST: Final = 60
_SEQUENCE_COST: Final = 3
_DOING_GAIN: Final = 10

_DRAWN: Final = 120
"""Moments that each step of the greedy selection compares."""

_DRAWN_FOR_SWAP: Final = 40
"""Moments that each question is compared with in a pass of swaps."""

_PASSES: Final = 6
"""Maximum number of passes that look for better choices of each question."""

_SWAP_PASSES: Final = 2

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


class Level:
    """The state of a selection, from which the increase of the cost follows for each further question."""

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


@dataclass
class Selector:
    """The selection of one template with actions as choices.

    Attributes:
        moments: Candidates of each moment, one per right choice, by the moment's hash.
        level: The state of the cost.
        taken: Account of near-duplicates and caps of all templates.
        cap: Maximum number of questions from one sequence.
        chosen: The selected question of each moment, by the moment's hash.
        twins: Hashes of the moments of twins, which stay selected.
    """

    moments: dict[int, list[Candidate]]
    level: Level
    taken: Taken
    cap: int
    chosen: dict[int, Question] = field(default_factory=dict)
    twins: set[int] = field(default_factory=set)

    def put(self, moment: int, question: Question) -> None:
        """Select a question."""
        self.chosen[moment] = question
        self.level.add(question)
        self.taken.add(question.candidate.subject)

    def take_out(self, moment: int) -> Question:
        """Select a question no more, and return it."""
        question = self.chosen.pop(moment)
        self.level.add(question, -1)
        self.taken.remove(question.candidate.subject)
        return question

    def admits(self, candidate: Candidate) -> bool:
        """Tell whether no near-duplicate and no cap forbids a candidate."""
        return self.level.of_sequence[candidate.sequence] < self.cap and self.taken.admits(candidate.subject)

    def put_twins(self, pair: Twins) -> bool:
        """Select two twins with the wrong choices that are cheapest for both; tell whether caps allow it."""
        first, second = pair
        shared = wrong_sets(first.wrong & second.wrong, 2)
        moments = [moment_hash(candidate) for candidate in pair]
        if not shared or any(moment in self.chosen for moment in moments) or not self.admits(first):
            return False
        key, options = min(first.key, second.key), []
        for wrong in shared:
            one = Question(first, tuple(sorted((second.truth, *wrong))), key)
            two = Question(second, tuple(sorted((first.truth, *wrong))), key)
            cost = self.level.cost_of(one)
            self.level.add(one)
            cost += self.level.cost_of(two)
            self.level.add(one, -1)
            options.append((cost, hash_of(key, wrong), one, two))
        *_, one, two = min(options)
        self.put(moments[0], one)
        if not self.admits(second):
            self.take_out(moments[0])
            return False
        self.put(moments[1], two)
        self.twins.update(moments)
        return True

    def fill(self, size: int) -> list[int]:
        """Select greedily up to a size; return the moments in the order of selection."""
        alive = np.array([moment for moment in sorted(self.moments) if moment not in self.chosen], np.uint64)
        order = []
        while len(self.chosen) < size and len(alive):
            drawn, refused = self._draw(alive, len(self.chosen), _DRAWN)
            alive = alive[~np.isin(alive, refused)]
            if not drawn:
                continue
            _, question = self.level.cheapest([one for moment in drawn for one in self.moments[moment]])
            moment = moment_hash(question.candidate)
            self.put(moment, question)
            order.append(moment)
            alive = alive[alive != moment]
        return order

    def improve(self) -> None:
        """Look for better choices of each question, and then for better moments."""
        for _ in range(_PASSES):
            if not sum(self._replace(moment, [moment]) for moment in self._loose()):
                break
        for turn in range(_SWAP_PASSES):
            for moment in self._loose():
                free = np.array([one for one in self.moments if one not in self.chosen], np.uint64)
                question = self.take_out(moment)
                drawn, _ = self._draw(free, hash_of(turn, moment), _DRAWN_FOR_SWAP)
                self.put(moment, question)
                self._replace(moment, drawn)

    def offers(self) -> list[Offer]:
        """Return what guessers see of the selected questions."""
        return [offer_of(question, self.level.counts) for _, question in sorted(self.chosen.items())]

    def _loose(self) -> list[int]:
        return sorted(self.chosen.keys() - self.twins)

    def _replace(self, moment: int, others: Sequence[int]) -> bool:
        """Replace a question by the cheapest one of some moments if that lowers the cost; tell whether it did."""
        question = self.take_out(moment)
        best = question
        if others:
            cost, better = self.level.cheapest([one for other in others for one in self.moments[other]])
            best = better if cost < self.level.cost_of(question) else question
        self.put(moment_hash(best.candidate), best)
        return best is not question

    def _draw(self, moments: npt.NDArray[np.uint64], salt: int, count: int) -> tuple[list[int], list[int]]:
        """Draw admitted moments in the order of their hash; return them and the refused ones."""
        drawn: list[int] = []
        refused: list[int] = []
        for index in np.argsort(permute(moments, salt)):
            moment = int(moments[index])
            (drawn if self.admits(self.moments[moment][0]) else refused).append(moment)
            if len(drawn) == count:
                break
        return drawn, refused


def group_moments(candidates: Iterable[Candidate]) -> dict[int, list[Candidate]]:
    """Group candidates with choices by their moment, and keep of each right choice the one with the smallest key."""
    moments: dict[int, dict[str, Candidate]] = defaultdict(dict)
    for candidate in sorted(candidates, key=lambda candidate: candidate.key):
        if wrong_sets(candidate.wrong):
            moments[moment_hash(candidate)].setdefault(candidate.truth, candidate)
    return {moment: list(moments[moment].values()) for moment in sorted(moments)}


def select_choices(
    candidates: Sequence[Candidate],
    quota: int,
    counts: LabelCounts,
    taken: Taken,
    sequences: int,
    twins: Sequence[Twins] = (),
) -> Selected:
    """Select the questions of a template with actions as choices.

    The size is the largest share of the quota, in steps of 5 %, for which no counting guesser is above its bound. Twins
    are kept as long as the bound holds with them at this size.

    Args:
        candidates: The proven candidates of the template, in any order.
        quota: Number of questions wanted.
        counts: How common actions are.
        taken: Account of near-duplicates and caps of all templates. The selected questions are added.
        sequences: Number of sequences of the data.
        twins: Matched pairs of time twins, the best first.

    Returns:
        The selected questions.
    """
    moments, cap = group_moments(candidates), sequence_cap(quota, sequences)

    def attempt(size: int, pairs: Sequence[Twins], order: Sequence[Question] | None = None) -> Selector:
        selector = Selector(moments, Level(candidates, counts), taken.copy(), cap)
        for pair in pairs:
            if len(selector.chosen) + 2 <= size:
                selector.put_twins(pair)
        if order is None:
            selector.fill(size)
        else:
            for question in order[:size]:
                selector.put(moment_hash(question.candidate), question)
        return selector

    whole = attempt(quota, ())
    order = list(whole.chosen.values())
    sizes = [len(order), *(size for size in sizes_of(quota) if size < len(order))]
    shortage = None if len(order) == quota else f"caps and near-duplicates leave {len(order)} of {len(moments)} moments"
    for size in sizes:
        best = attempt(size, (), order)
        best.improve()
        guesser = above_bound(best.offers())
        if guesser is None:
            break
        shortage = f"of {size} questions a guesser would have too many right: {guesser}"
    size = len(best.chosen)

    def with_twins(count: int) -> Selector | None:
        paired = attempt(size, twins[:count])
        paired.improve()
        return paired if above_bound(paired.offers()) is None else None

    best = keep_most(len(twins), with_twins) or best
    for _, question in sorted(best.chosen.items()):
        taken.add(question.candidate.subject)
    return Selected([question for _, question in sorted(best.chosen.items())], shortage)


def level_choices(candidates: Sequence[Candidate], counts: LabelCounts) -> list[Question]:
    """Choose the wrong choices of all candidates of a template, without leaving any out.

    Args:
        candidates: The candidates that have choices, in any order.
        counts: How common actions are.

    Returns:
        A question per candidate with at least three wrong choices, in the order of their keys.
    """
    level = Level(candidates, counts)
    ordered = sorted((x for x in candidates if wrong_sets(x.wrong)), key=lambda candidate: candidate.key)
    chosen: dict[str, Question] = {}
    for turn in range(1 + _PASSES):
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
