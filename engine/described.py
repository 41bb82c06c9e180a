"""Descriptions as plans state them: whom the conditions mean, found without asking how they were chosen."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import Rules

from .conditions import ANCHOR_TIME, Conditions, Words
from .descriptions import Descriptions
from .scene import NOBODY, Scene


def describe_given(
    scene: Scene, conditions: Conditions, given: Sequence[tuple[tuple[Condition, ...], int]], rules: Rules
) -> tuple[Descriptions, list[int]]:
    """The descriptions that mean exactly one person for certain, and for each of those given, as conditions and frame,
    its number among them, NOBODY where it means no one person.

    Conditions stand in the order in which generation chooses them.
    """
    code = {condition: place for place, condition in enumerate(conditions.vocabulary)}
    found: dict[tuple[int, ...], int] = {}
    numbers = []
    for stated, frame in given:
        codes = [code.get(_at_anchor(condition), NOBODY) for condition in stated]
        place = int(np.searchsorted(scene.keyframes, frame))
        known = place < len(scene.keyframes) and scene.keyframes[place] == frame
        if not known or NOBODY in codes or len(codes) > rules.max_conditions:
            # What is true of nobody in the scene describes nobody.
            numbers.append(NOBODY)
            continue
        codes.sort(key=lambda one: (int(conditions.rank[one]), one))
        uses = [place * len(conditions.vocabulary) + one for one in codes]
        sighting = _only(conditions, place, uses)
        if sighting == NOBODY:
            numbers.append(NOBODY)
            continue
        numbers.append(found.setdefault((sighting, *uses), len(found)))
    return _descriptions(conditions, [(sighting, list(uses)) for sighting, *uses in found], rules), numbers


def _at_anchor(condition: Condition) -> Condition:
    """A condition as the vocabulary holds it, whatever the plan calls the time of the description."""
    return condition if condition.at is None else msgspec.structs.replace(condition, at=ANCHOR_TIME)


def _only(conditions: Conditions, keyframe: int, uses: Sequence[int]) -> int:
    """The sighting of the one person of whom all uses are certainly true while nobody else could match, or NOBODY."""
    could = _could_match(conditions, keyframe, uses)
    sure = conditions.everybody[keyframe].copy()
    for use in uses:
        sure &= conditions.sure[use]
    if _count(could) != 1 or _count(sure) != 1:
        return NOBODY
    [moment] = conditions.members(keyframe, could).tolist()
    return int(np.flatnonzero(conditions.moment == moment)[0])


def _could_match(conditions: Conditions, keyframe: int, uses: Sequence[int]) -> Words:
    """Mask of the people at a keyframe whom none of these uses excludes."""
    mask: Words = conditions.everybody[keyframe].copy()
    for use in uses:
        mask &= ~conditions.masks[use]
    return mask


def _count(mask: Words) -> int:
    return int(np.bitwise_count(mask).sum())


def _descriptions(conditions: Conditions, named: Sequence[tuple[int, list[int]]], rules: Rules) -> Descriptions:
    uses = np.full((len(named), rules.max_conditions), NOBODY)
    left = np.zeros_like(uses)
    for row, (sighting, own) in enumerate(named):
        uses[row, : len(own)] = own
        keyframe = int(conditions.keyframe[sighting])
        for place, use in enumerate(own):
            left[row, place] = _count(_could_match(conditions, keyframe, [other for other in own if other != use]))
    sightings = np.array([sighting for sighting, _ in named], dtype=np.int64)
    states_pose = np.array(
        [any(conditions.states_pose[conditions.code(np.array(own))]) for _, own in named], dtype=bool
    )
    return Descriptions(
        conditions=conditions,
        sighting=sightings,
        moment=conditions.moment[sightings],
        uses=uses,
        left=left,
        general=np.ones(len(named), dtype=bool),
        poseless=~states_pose,
    )
