"""Select the questions of a template with choices, so that no choice is true more often than others.

A level is a state of the questions that are selected. It knows by how much each further question raises the cost.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from jrdb_avr.engine.generate.answer_levels import AnswerLevel
from jrdb_avr.engine.generate.asked import (
    Candidate,
    Question,
    Selected,
    Twins,
    keep_most,
    moment_hash,
    offer_of,
    sizes_of,
)
from jrdb_avr.engine.generate.choice_levels import ChoiceLevel
from jrdb_avr.engine.generate.choices import wrong_sets
from jrdb_avr.engine.generate.guessers import (
    JUDGED,
    MAX_ANSWER_SHARE,
    LabelCounts,
    Offer,
    above_bound,
    commonest_answer,
)
from jrdb_avr.engine.generate.hashes import hash_of, permute
from jrdb_avr.engine.generate.near_duplicates import Taken
from jrdb_avr.schema.choice_labels import CHOICE_LABELS

_DRAWN: Final = 120
"""Moments that each step of the greedy selection compares."""

_DRAWN_FOR_SWAP: Final = 40
"""Moments that each question is compared with in a pass of swaps."""

_PASSES: Final = 6
"""Maximum number of passes that look for better choices of each question."""

_SWAP_PASSES: Final = 2


class Level(Protocol):
    """State of the selected questions of a template.

    Attributes:
        of_sequence: Number of questions of each sequence.
    """

    of_sequence: Counter[str]

    def add(self, question: Question, sign: int = 1) -> None:
        """Add a question to the state, or remove it by the sign -1."""

    def allows(self, candidate: Candidate) -> bool:
        """Return whether the candidate may become a further question."""

    def cheapest(self, candidates: Sequence[Candidate]) -> tuple[int, Question]:
        """Find the question that raises the cost least.

        Args:
            candidates: Candidates with at least three wrong choices. Of equals the first one is taken.

        Returns:
            The increase of the cost, and the question.
        """

    def cost_of(self, question: Question) -> int:
        """Return by how much a question raises the cost."""


@dataclass
class Selector:
    """The selection of one template with choices.

    Attributes:
        moments: Candidates of each moment, one per right choice, by the moment's hash.
        level: The state of the cost.
        counts: How common actions are.
        taken: Account of near-duplicates and caps of all templates.
        cap: Maximum number of questions from one sequence.
        chosen: The selected question of each moment, by the moment's hash.
        twins: Hashes of the moments of twins, which stay selected.
    """

    moments: dict[int, list[Candidate]]
    level: Level
    counts: LabelCounts
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
        below = self.level.of_sequence[candidate.sequence] < self.cap and self.level.allows(candidate)
        return below and self.taken.admits(candidate.subject)

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
        if isinstance(self.level, AnswerLevel):
            # The choices are fixed, and other moments lower the cost too little for their time.
            self._drop_frequent()
            return
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

    def _drop_frequent(self) -> None:
        """Drop the costliest questions with the most frequent answer until its share is within bounds. Twins stay."""
        while len(self.chosen) >= JUDGED:
            answer, share = commonest_answer(self.offers())
            loose = [moment for moment in self._loose() if self.chosen[moment].candidate.truth == answer]
            if share <= MAX_ANSWER_SHARE or not loose:
                return
            self.take_out(max(loose, key=lambda moment: (self.level.cost_of(self.chosen[moment]), moment)))

    def offers(self) -> list[Offer]:
        """Return what guessers see of the selected questions."""
        return [offer_of(question, self.counts) for _, question in sorted(self.chosen.items())]

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


def select_level(
    candidates: Sequence[Candidate],
    quota: int,
    counts: LabelCounts,
    taken: Taken,
    cap: int,
    twins: Sequence[Twins] = (),
) -> Selected:
    """Select the questions of a template with choices.

    The size is the largest share of the quota, in steps of 5 %, for which no counting guesser is above its bound. Twins
    are kept as long as the bound holds with them at this size.

    Args:
        candidates: The proven candidates of the template, in any order.
        quota: Number of questions wanted.
        counts: How common actions are.
        taken: Account of near-duplicates and caps of all templates. The selected questions are added.
        cap: Maximum number of questions from one sequence.
        twins: Matched pairs of time twins, the best first.

    Returns:
        The selected questions.
    """
    moments = group_moments(candidates)

    def attempt(size: int, pairs: Sequence[Twins], order: Sequence[Question] | None = None) -> Selector:
        actions = candidates[0].truth in CHOICE_LABELS
        level = ChoiceLevel(candidates, counts) if actions else AnswerLevel(candidates)
        selector = Selector(moments, level, counts, taken.copy(), cap)
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
