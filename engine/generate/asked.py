"""Proven questions before and after the selection of their choices, and how many of them a template may have."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple, TypeVar

from jrdb_avr.engine.generate.guessers import JUDGED, LabelCounts, Offer
from jrdb_avr.engine.generate.hashes import hash_of, in_hash_order
from jrdb_avr.engine.generate.near_duplicates import Subject
from jrdb_avr.schema.rules import KEYFRAME_STEP

Result = TypeVar("Result")

_ALL_WEIGHT: Final = 50
_SEQUENCE_WEIGHT: Final = 20
_CONTEXT_WEIGHT: Final = 10
_STEPS: Final = 20
"""Sizes of a template are so many parts of its quota."""


class Candidate(NamedTuple):
    """A proven question for which choices are to be selected.

    Attributes:
        key: Hash of the question's sequence, target and plan, unique in a template.
        template: Name of the template.
        sequence: Name of the sequence.
        track: Track of the target.
        described: The description with its time, and the relations, as text.
        asked: Frames of the answer.
        truth: The right answer: an action, or one of four fixed answers.
        wrong: The answers that may be wrong choices.
        contexts: Names of the contexts and their weights. (`choice_contexts`, `answer_contexts`)
        event: The event of the target that only one question may be about, if any.
    """

    key: str
    template: str
    sequence: str
    track: int
    described: str
    asked: tuple[int, ...]
    truth: str
    wrong: frozenset[str]
    contexts: tuple[tuple[str, int], ...]
    event: str | None = None

    @property
    def moment(self) -> tuple[str, int, tuple[int, ...]]:
        """The person and the times asked. A template has one question only about them."""
        return self.sequence, self.track, self.asked

    @property
    def subject(self) -> Subject:
        """What near-duplicates and caps compare."""
        return Subject((self.sequence, self.track), self.template, self.asked, self.event)


class Question(NamedTuple):
    """A selected candidate with its wrong choices, in lexical order. `twin` is the common key of two time twins."""

    candidate: Candidate
    wrong: tuple[str, ...]
    twin: str | None = None

    @property
    def choices(self) -> tuple[str, ...]:
        """All choices in the order of the question. Time twins have the same order."""
        return in_hash_order((self.candidate.truth, *self.wrong), self.twin or self.candidate.key)


Twins = tuple[Candidate, Candidate]


class Selected(NamedTuple):
    """The questions of a template, in the order of their moments' hashes, and the reason if they are too few."""

    questions: list[Question]
    shortage: str | None


def offer_of(question: Question, counts: LabelCounts) -> Offer:
    """Return what counting guessers know of a question.

    Args:
        question: The question.
        counts: How common actions are.

    Returns:
        Its choices, with their ranks if they are actions.
    """
    one = question.candidate
    ranks = counts.ranks(one.sequence, one.asked[-1], one.truth, question.wrong)
    return Offer(one.sequence, one.truth, question.wrong, ranks)


def choice_contexts(
    sequence: str, conditions: Iterable[str], relation: str | None, wait: int
) -> tuple[tuple[str, int], ...]:
    """List the contexts of a question with actions as choices.

    Args:
        sequence: Name of the sequence.
        conditions: Words of each condition of the description.
        relation: The relation that leads to the target, or None; of a fork-join both, as one text.
        wait: Frames from the description to the time asked.

    Returns:
        The name and the weight of each context.
    """
    others = [f"condition {words}" for words in sorted(set(conditions))]
    others += [f"relation {relation}"] if relation else []
    others += [f"wait {doublings(wait)}"] if wait else []
    every = (("all", _ALL_WEIGHT), (f"sequence {sequence}", _SEQUENCE_WEIGHT))
    return (*every, *((name, _CONTEXT_WEIGHT) for name in others))


def doublings(wait: int) -> int:
    """Return how many times one second must be doubled to exceed a wait in frames."""
    return (wait // KEYFRAME_STEP).bit_length()


def sequence_cap(quota: int, sequences: int, percent: int = 20) -> int:
    """Return the maximum number of questions of a template from one sequence.

    Args:
        quota: Number of questions wanted of the template.
        sequences: Number of sequences.
        percent: Minimum share of the quota that one sequence may give.

    Returns:
        The larger one of that share and 1.5 times the even share, rounded up.
    """
    return max(-(-quota * percent // 100), -(-3 * quota // (2 * sequences)))


def moment_hash(candidate: Candidate) -> int:
    """Return the hash of a candidate's moment."""
    return hash_of(candidate.template, *candidate.moment)


def sizes_of(quota: int) -> list[int]:
    """Return the shares of a quota that are tried, the largest first; smaller ones are not judged."""
    judged = [size for step in range(_STEPS, 0, -1) if (size := quota * step // _STEPS) >= JUDGED]
    return [*judged, JUDGED - 1]


def keep_most(most: int, attempt: Callable[[int], Result | None]) -> Result | None:
    """Find the largest number of twins with which a selection succeeds, by halving.

    Args:
        most: Maximum number of pairs, which is tried first.
        attempt: Returns the selection with so many of the first pairs, or None if the bound does not hold.

    Returns:
        The selection, or None if no attempt succeeds.
    """
    best, low, high, count = None, 0, most, most
    while low < high:
        result = attempt(count)
        if result is None:
            high = count - 1
        else:
            best, low = result, count
        count = (low + high + 1) // 2
    return best
