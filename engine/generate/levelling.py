"""Select the questions of a template with choices, so that no choice is true more often than others.

Some questions are time twins: pairs that differ in one asked time and in their answers. A method that finds the right
person and ignores the time cannot answer both.
"""

from __future__ import annotations

import copy
import itertools
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, cast

import numpy as np

from jrdb_avr.engine.generate.asked import Candidate, Question, Selected, moment_hash, offer_of
from jrdb_avr.engine.generate.choices import wrong_sets
from jrdb_avr.engine.generate.guessers import (
    JUDGED,
    MAX_ANSWER_SHARE,
    LabelCounts,
    Offer,
    above_bound,
    commonest_answer,
)
from jrdb_avr.engine.generate.levels import Level
from jrdb_avr.engine.generate.near_duplicates import Taken, near_frames
from jrdb_avr.engine.report.hashes import Hashes, hash_of, permute
from jrdb_avr.schema.rules import Rules

MAX_TWINS: Final = {"change": 50, "presence": 50, "later_action": 9}
"""Maximum number of pairs of each template that has time twins."""

_DRAWN: Final = 120
"""Moments that each step of the greedy selection compares."""

_DRAWN_FOR_SWAP: Final = 40
"""Moments that each question is compared with in a pass of swaps."""

_PASSES: Final = 6
"""Maximum number of passes that look for better choices of each question."""

_SWAP_PASSES: Final = 2

_STEPS: Final = 20
"""Number of equal steps of a quota. Each size of a template is a whole number of steps."""

Twins = tuple[Candidate, Candidate]


@dataclass
class Selector:
    """The selection of one template with choices.

    Attributes:
        moments: Candidates of each moment, one per right choice, by the moment's hash.
        by_sequence: The hashes of the moments of each sequence.
        level: The state of the cost.
        counts: How common actions are.
        taken: Account of near-duplicates and caps of all templates.
        cap: Maximum number of questions from one sequence.
        chosen: The selected question of each moment, by the moment's hash.
        pairs: The two moments of each pair of twins. Twins stay selected.
    """

    moments: dict[int, list[Candidate]]
    by_sequence: dict[str, list[int]]
    level: Level
    counts: LabelCounts
    taken: Taken
    cap: int
    chosen: dict[int, Question] = field(default_factory=dict)
    pairs: list[tuple[int, int]] = field(default_factory=list)

    def put(self, question: Question) -> None:
        """Select a question."""
        self.chosen[moment_hash(question.candidate)] = question
        self.level.add(question)
        self.taken.add(question.candidate)

    def take_out(self, moment: int) -> Question:
        """Remove a question from the selection, and return it."""
        question = self.chosen.pop(moment)
        self.level.add(question, -1)
        self.taken.remove(question.candidate)
        return question

    def admits(self, candidate: Candidate) -> bool:
        """Return whether no near-duplicate and no cap forbids a candidate."""
        below = self.level.of_sequence[candidate.sequence] < self.cap and self.level.allows(candidate)
        return below and self.taken.admits(candidate)

    def restart(self, questions: Iterable[Question] = ()) -> None:
        """Select these questions and no others, without twins."""
        self.pairs.clear()
        for moment in list(self.chosen):
            self.take_out(moment)
        for question in questions:
            self.put(question)

    def put_twins(self, partners: dict[int, dict[int, Twins]], most: int) -> None:
        """Select time twins, the moment with the fewest possible twins first.

        Args:
            partners: Result of `find_twins`.
            most: Maximum number of pairs.
        """
        for moment in sorted(partners, key=lambda moment: (len(partners[moment]), moment)):
            for other in sorted(partners[moment], key=lambda one: (len(partners[one]), one)):
                if len(self.pairs) == most:
                    return
                if self.chosen.keys().isdisjoint((moment, other)) and self._put_pair(partners[moment][other]):
                    self.pairs.append((moment, other))
                    break

    def part_twins(self) -> None:
        """Make the last pair of twins ordinary questions, and look for better choices and moments for them."""
        pair = self.pairs.pop()
        for moment in pair:
            self.put(self.take_out(moment)._replace(twin=None))
        self.improve(pair)

    def _put_pair(self, pair: Twins) -> bool:
        """Select two twins with the wrong choices that are cheapest for both. Return whether caps allow it."""
        first, second = pair
        if not self.admits(first):
            return False
        key, options = min(first.key, second.key), []
        for wrong in wrong_sets(first.wrong & second.wrong, 2):
            one = Question(first, tuple(sorted((second.truth, *wrong))), key)
            two = Question(second, tuple(sorted((first.truth, *wrong))), key)
            (cost,) = self.level.costs_of([one])
            self.level.add(one)
            cost += self.level.costs_of([two])[0]
            self.level.add(one, -1)
            options.append((cost, hash_of(key, wrong), one, two))
        *_, one, two = min(options)
        self.put(one)
        if self.admits(second):
            self.put(two)
            return True
        self.take_out(moment_hash(first))
        return False

    def fill(self, size: int) -> None:
        """Select greedily up to a size."""
        free = (moment for moment in sorted(self.moments.keys() - self.chosen.keys()))
        alive = np.array([moment for moment in free if self.admits(self.moments[moment][0])], np.uint64)
        while len(self.chosen) < size and len(alive):
            drawn = _draw(alive, len(self.chosen), _DRAWN)
            _, question = self.level.cheapest([one for moment in drawn for one in self.moments[moment]])
            self.put(question)
            alive = alive[~np.isin(alive, np.array(self._refused_by(question.candidate), np.uint64))]

    def _refused_by(self, selected: Candidate) -> list[int]:
        """Return the moments of the same person, or of the whole sequence, that a selected question forbids."""
        full = self.level.of_sequence[selected.sequence] >= self.cap
        same = [(moment, self.moments[moment][0]) for moment in self.by_sequence[selected.sequence]]
        return [moment for moment, one in same if (full or one.track == selected.track) and not self.admits(one)]

    def improve(self, moments: Sequence[int]) -> None:
        """Look for better choices of the questions of some moments, and then for better moments, in their order."""
        if self.level.fixed:
            # Other moments lower the cost too little for their time.
            self._drop_frequent()
            return
        self.improve_choices(moments)
        for turn in range(_SWAP_PASSES):
            moments = [self._swap(moment, turn) for moment in moments]

    def improve_choices(self, moments: Sequence[int]) -> None:
        """Look for better choices of the questions of some moments, in the order of the moments."""
        for _ in range(_PASSES):
            before = [self.chosen[moment] for moment in moments]
            if before == [self._replace(moment, [moment]) for moment in moments]:
                break

    def _swap(self, moment: int, turn: int) -> int:
        """Replace a question by that of a better moment, if there is one. Return the selected moment."""
        free = np.array([one for one in self.moments if one not in self.chosen], np.uint64)
        question = self.take_out(moment)
        drawn = _draw(free, hash_of(turn, moment), _DRAWN_FOR_SWAP)
        drawn = [one for one in drawn if self.admits(self.moments[one][0])]
        self.put(question)
        return moment_hash(self._replace(moment, drawn).candidate)

    def _drop_frequent(self) -> None:
        """Drop the costliest questions with the most frequent answer until its share is within bounds. Twins stay."""
        while len(self.chosen) >= JUDGED:
            answer, share = commonest_answer(self.offers())
            loose = [moment for moment in self.loose() if self.chosen[moment].candidate.truth == answer]
            if share <= MAX_ANSWER_SHARE or not loose:
                return
            costs = self.level.costs_of([self.chosen[moment] for moment in loose])
            self.take_out(max(zip(costs, loose, strict=True))[1])

    def questions(self) -> list[Question]:
        """Return the selected questions in the order of the hashes of their moments."""
        return [question for _, question in sorted(self.chosen.items())]

    def offers(self) -> list[Offer]:
        """Return what guessers see of the selected questions."""
        return [offer_of(question, self.counts) for question in self.questions()]

    def loose(self) -> list[int]:
        """Return the hashes of the moments of all questions but twins, in order."""
        return sorted(self.chosen.keys() - set(itertools.chain.from_iterable(self.pairs)))

    def _replace(self, moment: int, others: Sequence[int]) -> Question:
        """Replace a question by the cheapest one of some moments if that lowers the cost. Return the selected one."""
        question = best = self.take_out(moment)
        if others:
            cost, better = self.level.cheapest([one for other in others for one in self.moments[other]])
            best = better if [cost] < self.level.costs_of([question]) else question
        self.put(best)
        return best


def _draw(moments: Hashes, salt: int, count: int) -> list[int]:
    """Draw some of the moments, in the order of a hash."""
    return cast(list[int], moments[np.argsort(permute(moments, salt))[:count]].tolist())


def make_selector(candidates: Sequence[Candidate], counts: LabelCounts, taken: Taken, cap: int) -> Selector:
    """Make the selection of a template, with nothing selected.

    Args:
        candidates: Candidates of the template, in any order. For each moment and right choice, the one with the
            smallest key counts.
        counts: How common actions are.
        taken: Account of near-duplicates and caps of all templates. The selection changes a copy of it.
        cap: Maximum number of questions from one sequence.

    Returns:
        The selection.
    """
    moments: dict[int, dict[str, Candidate]] = defaultdict(dict)
    for candidate in sorted(candidates, key=lambda candidate: candidate.key):
        if wrong_sets(candidate.wrong):
            moments[moment_hash(candidate)].setdefault(candidate.truth, candidate)
    ordered = {moment: list(moments[moment].values()) for moment in sorted(moments)}
    by_sequence = defaultdict(list)
    for moment, (candidate, *_) in ordered.items():
        by_sequence[candidate.sequence].append(moment)
    return Selector(ordered, by_sequence, Level(candidates, counts), counts, copy.deepcopy(taken), cap)


def level_choices(candidates: Sequence[Candidate], counts: LabelCounts, rules: Rules) -> list[Question]:
    """Choose the wrong choices of all moments of a template, without leaving any out.

    Args:
        candidates: The candidates, in any order.
        counts: How common actions are.
        rules: The thresholds.

    Returns:
        A question of each moment that has a candidate with at least three wrong choices.
    """
    selector = make_selector(candidates, counts, Taken(rules), len(candidates))
    order = sorted(selector.moments, key=lambda moment: selector.moments[moment][0].key)
    for moment in order:
        selector.put(selector.level.cheapest(selector.moments[moment])[1])
    selector.improve_choices(order)
    return selector.questions()


def select_level(candidates: Sequence[Candidate], quota: int, counts: LabelCounts, taken: Taken, cap: int) -> Selected:
    """Select the questions of a template with choices.

    The size is the largest share of the quota, in steps of 5 %, for which no counting guesser is above its bound. Twins
    are kept as long as the bound holds with them at this size.

    Args:
        candidates: The proven candidates of the template, in any order.
        quota: Number of questions wanted.
        counts: How common actions are.
        taken: Account of near-duplicates and caps of all templates. The selected questions are added.
        cap: Maximum number of questions from one sequence.

    Returns:
        The selected questions.
    """
    selector = make_selector(candidates, counts, taken, cap)
    selector.fill(quota)
    order, total = list(selector.chosen.values()), len(selector.moments)
    shortage = None if len(order) == quota else f"caps and near-duplicates leave {len(order)} of {total} moments"
    # Smaller sizes are not judged.
    sizes = [size for step in range(_STEPS, 0, -1) if JUDGED <= (size := quota * step // _STEPS) < len(order)]
    for size in (len(order), *sizes, min(JUDGED - 1, len(order))):
        selector.restart(order[:size])
        selector.improve(selector.loose())
        guesser = above_bound(selector.offers())
        if guesser is None:
            break
        shortage = f"of {size} questions a guesser would have too many right: {guesser}"
    questions = selector.questions()
    most = min(MAX_TWINS.get(candidates[0].template, 0), len(questions) // 2)
    partners = find_twins(candidates, taken.rules) if most else {}
    # Fewer pairs at the start may leave some pairs if many pairs leave none.
    while partners and most and not selector.pairs:
        selector.restart()
        selector.put_twins(partners, most)
        selector.fill(len(questions))
        selector.improve(selector.loose())
        while selector.pairs and above_bound(selector.offers()):
            selector.part_twins()
        most //= 2
    questions = selector.questions() if selector.pairs else questions
    for question in questions:
        taken.add(question.candidate)
    return questions, shortage


# -- time twins -------------------------------------------------------------------------------------------------------


def find_twins(candidates: Iterable[Candidate], rules: Rules) -> dict[int, dict[int, Twins]]:
    """Find the pairs of candidates that can be time twins.

    Args:
        candidates: The proven candidates of one template, in any order. Twins have equal descriptions, so all
            candidates of a moment count, each with its description.
        rules: The thresholds.

    Returns:
        The pair of candidates for each two moments that can be twins, by the hash of one moment, then by the hash of
        the other. Each pair is in the result in both directions.
    """
    groups: dict[tuple[str, int, str], list[Candidate]] = defaultdict(list)
    for candidate in sorted(candidates, key=lambda candidate: candidate.key):
        groups[candidate.sequence, candidate.track, candidate.described].append(candidate)
    partners: dict[int, dict[int, Twins]] = defaultdict(dict)
    for pair in itertools.chain.from_iterable(itertools.combinations(group, 2) for group in groups.values()):
        if may_be_twins(*pair, rules):
            for moment, other in itertools.permutations(map(moment_hash, pair)):
                kept = partners[moment].setdefault(other, pair)
                partners[moment][other] = min(kept, pair, key=lambda two: hash_of(*(one.key for one in two)))
    return partners


def may_be_twins(first: Candidate, second: Candidate, rules: Rules) -> bool:
    """Return whether two candidates of a template with equal descriptions can be twins.

    Args:
        first: A candidate.
        second: Another one of the same template, person and description.
        rules: The thresholds.

    Returns:
        True if exactly one asked time differs, by more than near-duplicates may, each answer is false in the other
        question, and the same four choices fit both.
    """
    apart = [abs(time - other) for time, other in zip(first.asked, second.asked, strict=True) if time != other]
    if len(apart) != 1 or apart[0] <= near_frames(first.template, rules):
        return False
    if first.truth not in second.wrong or second.truth not in first.wrong:
        return False
    return bool(wrong_sets(first.wrong & second.wrong, 2))
