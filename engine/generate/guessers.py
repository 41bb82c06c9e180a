"""Guessers that count: their shares of right answers bound the sizes of templates and are printed in the blind report.

All shares are exact fractions, so that they depend on no library and no processor.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Final, NamedTuple

from jrdb_avr.schema.choice_labels import CHOICE_LABELS

BOUND: Final = Fraction(34, 100)
"""Maximum share of each counting guesser in a template of `JUDGED` or more questions."""

JUDGED: Final = 60
"""Minimum number of questions of a template that the bound judges."""

COUNTING: Final = ("data", "sequence", "label", "set", "pair")
"""Guessers that the bound judges: the commonest choice in all data and in the sequence; the choice that is most often
true elsewhere, by itself, with its set of choices, and beside each of the other choices."""

MAX_ANSWER_SHARE: Final = Fraction(31, 100)
"""Maximum share of one answer in a template with four fixed answers."""

_PRIOR: Final = 4
"""Weight of the prior belief, in questions: one choice of four is true."""


class Offer(NamedTuple):
    """The choices of a question.

    Attributes:
        sequence: Name of the sequence.
        truth: The right choice.
        wrong: The wrong choices.
        ranks: How many choices are commoner than the right one in all data, in the sequence and in the frame; empty if
            the choices are not actions.
    """

    sequence: str
    truth: str
    wrong: tuple[str, ...]
    ranks: tuple[int, ...] = ()

    @property
    def choices(self) -> tuple[str, ...]:
        """All choices, sorted."""
        return tuple(sorted((self.truth, *self.wrong)))


class LabelCounts:
    """How many people in clear view certainly do each action, at each keyframe, in each sequence and in all data.

    Attributes:
        present: For each sequence, the actions that a person in clear view certainly does at a keyframe.
    """

    def __init__(self, counts: Mapping[tuple[str, int], Mapping[str, int]]) -> None:
        """Add up the counts of all keyframes.

        Args:
            counts: For each (sequence, keyframe), the number of people in clear view by action, 1 or more.
        """
        self._at = counts
        self._orders: dict[tuple[str, int], list[dict[str, int]]] = {}
        self._data: Counter[str] = Counter()
        self._in: dict[str, Counter[str]] = defaultdict(Counter)
        for (sequence, _), number in counts.items():
            self._data.update(number)
            self._in[sequence].update(number)
        self.present = {sequence: frozenset(number) for sequence, number in self._in.items()}

    def doing(self, sequence: str, frame: int) -> frozenset[str]:
        """Return the actions that people in clear view certainly do at a keyframe."""
        return frozenset(self._at.get((sequence, frame), ()))

    def orders(self, sequence: str, frame: int) -> list[dict[str, int]]:
        """Return the position of each action, the commonest first, in all data, in the sequence and at the keyframe."""
        if (sequence, frame) not in self._orders:
            numbers = (self._data, self._in[sequence], self._at.get((sequence, frame), {}))
            ordered = [sorted(CHOICE_LABELS, key=self._by(number)) for number in numbers]
            self._orders[sequence, frame] = [{label: index for index, label in enumerate(labels)} for labels in ordered]
        return self._orders[sequence, frame]

    def ranks(self, sequence: str, frame: int, truth: str, wrong: Sequence[str]) -> tuple[int, ...]:
        """Return how many wrong choices are commoner than the right one, in each of `orders`.

        Args:
            sequence: Name of the sequence.
            frame: Frame of the answer.
            truth: The right choice.
            wrong: The wrong choices.

        Returns:
            The three ranks, or an empty tuple if the choices are not actions.
        """
        if truth not in CHOICE_LABELS:
            return ()
        return tuple(sum(order[label] < order[truth] for label in wrong) for order in self.orders(sequence, frame))

    def _by(self, number: Mapping[str, int]) -> Callable[[str], tuple[int, int, str]]:
        """Return the key that sorts the commonest action first."""
        return lambda label: (-number.get(label, 0), -self._data[label], label)


def guesser_scores(offers: Sequence[Offer]) -> dict[str, list[Fraction]]:
    """Compute the scores of each counting guesser.

    Args:
        offers: The choices of all questions of a template.

    Returns:
        The score of each question by the name of the guesser, for each guesser of `COUNTING` that applies. If n choices
        are equally good, each counts one nth. In addition "frame" takes the commonest choice in the frame, and "least
        label", "least set" and "least pair" take the choice that is least often true elsewhere; they are only
        information.
    """
    scores = {}
    if all(offer.ranks for offer in offers):
        for index, name in enumerate(("data", "sequence", "frame")):
            scores[name] = [Fraction(offer.ranks[index] == 0) for offer in offers]
    true, offered = _tallies(offers)
    for name in ("label", "set", "pair"):
        beliefs = [_beliefs(offer, name, true, offered) for offer in offers]
        for prefix, take in (("", max), ("least ", min)):
            scores[prefix + name] = [
                _share(belief, offer.truth, take) for belief, offer in zip(beliefs, offers, strict=True)
            ]
    return scores


def guesser_shares(offers: Sequence[Offer]) -> dict[str, Fraction]:
    """Return the mean of each guesser's scores (`guesser_scores`). The dictionary is empty without offers."""
    return {name: sum(scores, Fraction()) / len(offers) for name, scores in guesser_scores(offers).items() if offers}


def above_bound(offers: Sequence[Offer]) -> str | None:
    """Name the best guesser above `BOUND`.

    Args:
        offers: The choices of all questions of a template.

    Returns:
        The name with its share of right answers, or None if no guesser is above the bound or the questions are too few
        to be judged.
    """
    if len(offers) < JUDGED:
        return None
    shares = guesser_shares(offers)
    share, name = max((shares[name], name) for name in COUNTING if name in shares)
    if share > BOUND:
        return f"{name} {float(100 * share):.1f} %"
    answer, share = commonest_answer(offers)
    common = not offers[0].ranks and share > MAX_ANSWER_SHARE
    return f"the answer {answer!r} is true in {float(100 * share):.1f} %" if common else None


def commonest_answer(offers: Sequence[Offer]) -> tuple[str, Fraction]:
    """Return the answer that is true most often, and its share. Of equals it is the first in the alphabet."""
    numbers = Counter(offer.truth for offer in offers)
    answer = min(numbers, key=lambda answer: (-numbers[answer], answer))
    return answer, Fraction(numbers[answer], len(offers))


_Key = tuple[object, ...]


def _keys(guesser: str, choice: str, choices: Sequence[str]) -> list[_Key]:
    """Return what a guesser counts for a choice, the most general first."""
    others = [(choice, other) for other in choices if other != choice]
    more: dict[str, list[_Key]] = {"label": [], "set": [(choice, "of", tuple(choices))], "pair": [*others]}
    return [(choice,), *more[guesser]]


def _tallies(offers: Iterable[Offer]) -> tuple[Counter[_Key], Counter[_Key]]:
    """Count how often each key is true and offered, in all sequences and in each one (the key's first item)."""
    true: Counter[_Key] = Counter()
    offered: Counter[_Key] = Counter()
    for offer in offers:
        choices = offer.choices
        for choice in choices:
            for key in {*_keys("set", choice, choices), *_keys("pair", choice, choices)}:
                for scope in ("", offer.sequence):
                    offered[scope, *key] += 1
                    true[scope, *key] += choice == offer.truth
    return true, offered


def _beliefs(offer: Offer, guesser: str, true: Mapping[_Key, int], offered: Mapping[_Key, int]) -> dict[str, Fraction]:
    """Return the belief in each choice by the questions of other sequences."""
    beliefs = {}
    for choice in offer.choices:
        # A belief is (right + prior * belief before) / (offered + prior). One fraction at the end is faster.
        above, below = 1, 4
        for key in _keys(guesser, choice, offer.choices):
            right, all_of = (tally["", *key] - tally[offer.sequence, *key] for tally in (true, offered))
            above, below = right * below + _PRIOR * above, (all_of + _PRIOR) * below
        beliefs[choice] = Fraction(above, below)
    return beliefs


def _share(beliefs: Mapping[str, Fraction], truth: str, take: Callable[[Iterable[Fraction]], Fraction]) -> Fraction:
    """Return the share of a question that a guesser gets who takes the choice with the extreme belief."""
    extreme = take(beliefs.values())
    best = [choice for choice, belief in beliefs.items() if belief == extreme]
    return Fraction(truth in best, len(best))
