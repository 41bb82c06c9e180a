"""Decide from a person's action labels which actions are true and false at a time, and which wrong choices fit.

The labels of a person are given at keyframes, one second apart. A missing keyframe is a keyframe without the person or
without a list of actions.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from functools import lru_cache
from typing import Final

from jrdb_avr.queries.compiler.reads import outcome_of_action
from jrdb_avr.schema.choice_labels import CHOICE_LABELS, ListedActions, may_be_same
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.rules import KEYFRAME_STEP

_WINDOW: Final = 3
"""Number of keyframes before and after the time asked that must lack a wrong choice. For a pose it is one."""


Timeline = Mapping[int, ListedActions]
"""The labels of a person by keyframe, in frames."""


def true_labels(timeline: Timeline, frame: int) -> frozenset[str]:
    """Find the actions that may be the right choice at a keyframe.

    Args:
        timeline: The labels of the person.
        frame: The keyframe asked about.

    Returns:
        The actions that are certain at the keyframe and at the keyframe before or after it.
    """
    near = [timeline[at].certain for at in (frame - KEYFRAME_STEP, frame + KEYFRAME_STEP) if at in timeline]
    present = timeline.get(frame, ListedActions()).certain.intersection(CHOICE_LABELS)
    return present & frozenset().union(*near)


def false_labels(timeline: Timeline, frame: int) -> frozenset[str]:
    """Find the actions that may be wrong choices at a keyframe.

    Args:
        timeline: The labels of the person.
        frame: The keyframe asked about.

    Returns:
        The actions that are certainly false at the keyframe and that no keyframe near it has, hard labels included. For
        poses these are the keyframes within one second, for other actions those within three seconds.
    """
    beside = _labels_within(timeline, frame, 1)
    around = _labels_within(timeline, frame, _WINDOW)
    different = different_labels(timeline.get(frame))
    return frozenset(label for label in different if label not in (beside if label in POSES else around))


@lru_cache(maxsize=4096)
def different_labels(labels: ListedActions | None) -> tuple[str, ...]:
    """Return the actions that are certainly false at a keyframe, by the labels of a person (None: there is no list)."""
    return tuple(label for label in CHOICE_LABELS if outcome_of_action(labels, label) == "different")


@lru_cache(maxsize=4096)
def wrong_choices(
    truth: str, false: frozenset[str], implied: frozenset[str], present: frozenset[str]
) -> frozenset[str]:
    """Find the actions that may be wrong choices beside a right one.

    Args:
        truth: The right choice.
        false: The actions that are false of the target (`false_labels`).
        implied: The actions that the text of the question states or implies (`wording.text.implied_choices`).
        present: The actions that are certainly true of a person in clear view at a keyframe of the sequence.

    Returns:
        The actions, or none if the text of the question states or implies the right choice.
    """
    if truth in implied:
        return frozenset()
    return frozenset(x for x in false if x in present and x not in implied and not may_be_same(x, truth))


@lru_cache(maxsize=4096)
def wrong_sets(wrong: frozenset[str], size: int = 3) -> tuple[tuple[str, ...], ...]:
    """List the sets of wrong choices without two actions that may be called the same.

    Args:
        wrong: The actions of `wrong_choices`.
        size: Number of actions in a set.

    Returns:
        The sets, each sorted, in lexical order.
    """
    ordered = sorted(wrong)
    apart = {pair for pair in itertools.combinations(ordered, 2) if not may_be_same(*pair)}
    return tuple(x for x in itertools.combinations(ordered, size) if apart.issuperset(itertools.combinations(x, 2)))


def _labels_within(timeline: Timeline, frame: int, keyframes: int) -> frozenset[str]:
    """Return all labels, certain or hard, within a number of keyframes before and after a frame."""
    steps = range(-keyframes, keyframes + 1)
    near = [timeline[at] for step in steps if (at := frame + step * KEYFRAME_STEP) in timeline]
    return frozenset().union(*(labels.certain | labels.hard for labels in near))
