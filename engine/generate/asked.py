"""Records of proven questions before and after the selection of their choices; contexts and caps of the selection."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from jrdb_avr.engine.generate.guessers import LabelCounts, Offer
from jrdb_avr.engine.report.hashes import hash_of, in_hash_order
from jrdb_avr.schema.rules import KEYFRAME_STEP

_PARTS: Final = 4
"""Times in a sequence are compared by its quarters."""


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
        event: Name of the event that the question asks about, or None. At most one question of a person has it.
        form: Form of the template.
        row: The row of a generator that makes the proposal again, encoded.
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
    form: str = ""
    row: bytes = b""

    @property
    def person(self) -> tuple[str, int]:
        """Sequence and track of the target."""
        return self.sequence, self.track


class Question(NamedTuple):
    """A selected candidate with its wrong choices, in lexical order. `twin` is the common key of two time twins."""

    candidate: Candidate
    wrong: tuple[str, ...]
    twin: str | None = None

    @property
    def key(self) -> str:
        """A key of the question with its choices and its twin."""
        return " ".join((self.candidate.template, self.candidate.key, *self.choices, self.twin or ""))

    @property
    def choices(self) -> tuple[str, ...]:
        """All choices in the order of the question. Time twins have the same order."""
        return in_hash_order((self.candidate.truth, *self.wrong), self.twin or self.candidate.key)


Selected = tuple[list[Question], str | None]
"""The questions of a template, in the order of their moments' hashes, and the reason if they are too few."""


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
    return (("all", 50), (f"sequence {sequence}", 20), *((name, 10) for name in others))


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


def doublings(wait: int) -> int:
    """Return how many times one second must be doubled to exceed a wait in frames."""
    return (wait // KEYFRAME_STEP).bit_length()


def sequence_cap(template: str, quota: int, sequences: int) -> int:
    """Return the maximum number of questions of a template from one sequence.

    Args:
        template: Name of the template.
        quota: Number of questions wanted of the template.
        sequences: Number of sequences.

    Returns:
        The larger one of a fifth of the quota (a tenth for presence) and 1.5 times the even share, rounded up.
    """
    percent = 10 if template == "presence" else 20
    return max(-(-quota * percent // 100), -(-3 * quota // (2 * sequences)))


def moment_hash(candidate: Candidate) -> int:
    """Return the hash of a candidate's person and asked times. A template has at most one question about them."""
    return hash_of(candidate.template, candidate.sequence, candidate.track, candidate.asked)
