"""The four choices of a question: one is true, the others are wrong in ways that reveal how a method fails.

A distractor may be the answer of a perturbed program: at the description's time instead of the stated one, at a
shifted time, of a look-alike who could match when a condition is dropped; of sets that level the answers alike,
selection takes the one with the most of them. The others are poses known to be false for the target at the stated time.
Nothing unknown is ever a distractor, and no pose that the question states.

No two choices overlap each other. If only the true one were compared with the others, it would stand out as the pose
that overlaps none of them. For the same reason a pose question has several sets of choices, among which selection
picks one whose other members are true as often.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from jrdb_avr.schema.labels import POSES, choice_text, overlapping

CHOICE_COUNT: Final = 4

SETS: Final = 16
"""Sets of choices of one candidate that selection may pick from; those of the commonest poses."""

APART: Final = tuple(
    one
    for one in itertools.combinations(POSES, CHOICE_COUNT)
    if not any(other in overlapping(pose) for pose, other in itertools.combinations(one, 2))
)
"""Every four poses of which no two may be said of one person; the first hold the poses annotated most."""


@dataclass(frozen=True, slots=True)
class Choices:
    """The texts in their order, the number of the true one from 1, and per choice the perturbation that yields it."""

    texts: tuple[str, ...]
    true: int
    perturbations: tuple[str | None, ...]


def arrange(
    sets: tuple[tuple[str, ...], ...], truth: str, key: str, perturbed: Iterator[tuple[str, str]]
) -> tuple[Choices, ...]:
    """Order sets of answers by hash, those with most answers of perturbed programs first.

    Args:
        sets: Sets of four answers.
        truth: True answer.
        key: Key of the question, which is part of the hash.
        perturbed: Answers of perturbed programs with their names, the most telling first.

    Returns:
        The choices of each set.
    """
    texts = {text for one in sets for text in one}
    mistakes: dict[str, str] = {}
    for text, perturbation in perturbed:
        if text in texts and text != truth:
            mistakes.setdefault(text, perturbation)
        if len(mistakes) == len(texts) - 1:
            break
    ranks = {text: hashlib.sha256(f"{key}\n{text}".encode()).digest() for text in texts}
    found = [_ordered(one, truth, mistakes, ranks) for one in sets]
    return tuple(sorted(found, key=lambda choices: choices.perturbations.count(None)))


@lru_cache(1024)
def pose_sets(truth: str, barred: frozenset[str]) -> tuple[tuple[str, ...], ...]:
    """Return the sets of postures with a posture and without postures that may be no choice."""
    return tuple(one for one in APART if truth in one and not barred.intersection(one))[:SETS]


def _ordered(texts: tuple[str, ...], truth: str, mistakes: Mapping[str, str], ranks: Mapping[str, bytes]) -> Choices:
    """A set of choices in an order that says nothing."""
    order = sorted(texts, key=ranks.__getitem__)
    return Choices(tuple(map(choice_text, order)), order.index(truth) + 1, tuple(map(mistakes.get, order)))
