"""Conditions that hold of people at keyframes, and whom each excludes.

A *sighting* is a person with a box at a keyframe; a *use* is a condition at a keyframe where it is true of somebody.
Facts have three values: a use excludes the people of whom the condition is certainly false; of whom it is unknown,
they could match. Per use, the excluded people are a bit mask over the keyframe's people, 64 to a word.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.vocabulary import ACTIONS, DISTANCE_WORDS, OTHER_ACTIONS, POSES, ROBOT_SECTORS

from .scene import NOBODY, Bools, Ints, Scene

Words = npt.NDArray[np.uint64]

ANCHOR_TIME: Final = "t0"
"""Name of the time at which the conditions of a description hold."""

_KINDS: Final = ("pose", "action", "sector", "distance", "group_size")
_FIRST_CODE: Final = np.cumsum([0, len(POSES), len(OTHER_ACTIONS), len(ROBOT_SECTORS), len(DISTANCE_WORDS)])
"""Conditions are coded as one number: the kinds' ranges follow each other, the open-ended group sizes last."""

POSE, ACTION, SECTOR, DISTANCE, GROUP_SIZE = range(len(_KINDS))


@dataclass(frozen=True)
class Conditions:
    """Who is there at each keyframe, what is true of them, and whom that excludes.

    rows, keyframe, slot: per sighting, its row in `boxes`, its keyframe's number and its place in the masks.
    held: per sighting the uses true of it, by the rules' order of kinds, filled up with NOBODY.
    code, rank, masks: per use the condition, the place of its kind in the rules' order, and whom it excludes.
    everybody: per keyframe the mask of all people with a box; tracks: per keyframe and slot the track.
    """

    rows: Ints
    keyframe: Ints
    slot: Ints
    held: Ints
    code: Ints
    rank: Ints
    masks: Words
    everybody: Words
    tracks: Ints

    @property
    def kind(self) -> Ints:
        """Per use, the kind's number."""
        return kind_of(self.code)

    def alone(self) -> Words:
        """Per sighting, the mask that holds only this person."""
        masks = np.zeros((len(self.rows), self.everybody.shape[1]), dtype=np.uint64)
        masks[np.arange(len(self.rows)), self.slot // 64] = np.uint64(1) << (self.slot % 64).astype(np.uint64)
        return masks

    def members(self, keyframe: int, mask: Words) -> list[int]:
        """Tracks of a mask's people, sorted."""
        slots = np.flatnonzero(np.unpackbits(mask.view(np.uint8), bitorder="little"))
        return sorted(self.tracks[keyframe, slots].tolist())


def kind_of(code: Ints) -> Ints:
    return np.searchsorted(_FIRST_CODE, code, side="right") - 1


def condition_of(code: int) -> Condition:
    """The plan's condition of a code, holding at the description's time."""
    kind = int(np.searchsorted(_FIRST_CODE, code, side="right")) - 1
    value = code - int(_FIRST_CODE[kind])
    match kind:
        case 0:
            return Condition(action=POSES[value], at=ANCHOR_TIME)
        case 1:
            return Condition(action=OTHER_ACTIONS[value], at=ANCHOR_TIME)
        case 2:
            return Condition(attribute="sector", value=ROBOT_SECTORS[value], at=ANCHOR_TIME)
        case 3:
            return Condition(attribute="distance", value=DISTANCE_WORDS[value], at=ANCHOR_TIME)
        case _:
            return Condition(attribute="group_size", value=value, at=ANCHOR_TIME)


@dataclass(frozen=True)
class _Facts:
    """Per sighting: codes of its attributes, NOBODY where unknown; sure and maybe: a column per word of ACTIONS."""

    pose: Ints
    group_size: Ints
    sector: Ints
    sector_other: Ints
    distance: Ints
    distance_other: Ints
    listed: Bools
    sure: Bools
    maybe: Bools


def find_conditions(scene: Scene, rules: Rules) -> Conditions:
    """All conditions true of somebody at a keyframe of the scene."""
    moments = np.flatnonzero(scene.moment_rows != NOBODY)
    # By keyframe, then person: people of a keyframe lie side by side and their slots count up.
    moments = moments[np.lexsort((moments, moments % len(scene.keyframes)))] if len(moments) else moments
    keyframe = moments % len(scene.keyframes)
    rows = scene.moment_rows[moments]
    people = np.bincount(keyframe, minlength=len(scene.keyframes))
    start = np.concatenate([[0], np.cumsum(people)[:-1]]).astype(np.int64)
    slot = np.arange(len(rows)) - start[keyframe]
    width = max(1, -(-int(people.max(initial=0)) // 64))
    facts = _facts(scene, moments, rows)

    sighting, code = _true_facts(facts)
    order = {kind: place for place, kind in enumerate(rules.condition_order)}
    rank_of_kind = np.array([order.get(kind, NOBODY) for kind in _KINDS])
    used = rank_of_kind[kind_of(code)] != NOBODY
    sighting, code = sighting[used], code[used]
    uses, use_of_fact = np.unique(keyframe[sighting] * _CODES + code, return_inverse=True)
    use_keyframe, use_code = uses // _CODES, uses % _CODES
    rank = rank_of_kind[kind_of(use_code)]

    tracks = np.full((len(scene.keyframes), width * 64), NOBODY)
    tracks[keyframe, slot] = scene.tracks[scene.persons(moments)]
    return Conditions(
        rows=rows,
        keyframe=keyframe,
        slot=slot,
        held=_held(sighting, use_of_fact, rank, len(rows)),
        code=use_code,
        rank=rank,
        masks=_exclusions(facts, use_keyframe, use_code, start, people, width),
        everybody=_pack(tracks != NOBODY),
        tracks=tracks,
    )


_CODES: Final = 1 << 20
"""More than any condition's code; group sizes beyond it do not occur."""


def _facts(scene: Scene, moments: Ints, rows: Ints) -> _Facts:
    group_size = scene.column("group_size")[rows]
    sure = np.zeros((len(rows), len(ACTIONS)), dtype=bool)
    maybe = np.zeros_like(sure)
    # Every action interval is spread over the keyframes it covers.
    table = scene.actions
    low = np.searchsorted(scene.keyframes, table["first"].to_numpy(), side="left")
    high = np.searchsorted(scene.keyframes, table["last"].to_numpy(), side="right")
    span = np.maximum(high - low, 0)
    row = np.repeat(np.arange(len(table)), span)
    at = np.arange(len(row)) - np.repeat(np.cumsum(span) - span, span) + low[row]
    sighting_of = np.full(scene.moment_count, NOBODY)
    sighting_of[moments] = np.arange(len(moments))
    person = scene.person_of(table["track"].to_numpy())
    sighting = sighting_of[person[row] * len(scene.keyframes) + at]
    action = np.asarray(pc.index_in(table["action"], value_set=pa.array(ACTIONS)).to_numpy(), dtype=np.int64)[row]
    certain = np.asarray(table["certain"].to_numpy(), dtype=bool)[row]
    kept = sighting != NOBODY
    maybe[sighting[kept], action[kept]] = True
    kept &= certain
    sure[sighting[kept], action[kept]] = True
    return _Facts(
        pose=scene.poses[rows],
        group_size=np.where(np.isnan(group_size), NOBODY, group_size).astype(np.int64),
        sector=scene.codes("sector", ROBOT_SECTORS)[rows],
        sector_other=scene.codes("sector_other", ROBOT_SECTORS)[rows],
        distance=scene.codes("distance_word", DISTANCE_WORDS)[rows],
        distance_other=scene.codes("distance_word_other", DISTANCE_WORDS)[rows],
        listed=scene.flag("listed")[rows],
        sure=sure,
        maybe=maybe,
    )


def _true_facts(facts: _Facts) -> tuple[Ints, Ints]:
    """(sighting, code) of every condition that is certainly true."""
    found = []
    certain = (
        (POSE, facts.pose, facts.pose != NOBODY),
        (SECTOR, facts.sector, facts.sector_other == NOBODY),
        (DISTANCE, facts.distance, (facts.distance != NOBODY) & (facts.distance_other == NOBODY)),
        (GROUP_SIZE, facts.group_size, facts.group_size != NOBODY),
    )
    for kind, value, known in certain:
        sighting = np.flatnonzero(known)
        found.append((sighting, value[sighting] + _FIRST_CODE[kind]))
    sighting, action = np.nonzero(facts.sure[:, len(POSES) :])
    found.append((sighting, action + _FIRST_CODE[ACTION]))
    return np.concatenate([s for s, _ in found]), np.concatenate([c for _, c in found])


def _held(sighting: Ints, use: Ints, rank: Ints, count: int) -> Ints:
    """The uses true of each sighting as rows of a matrix, ordered by rank and code, filled up with NOBODY."""
    order = np.lexsort((use, rank[use], sighting))
    sighting, use = sighting[order], use[order]
    place = np.arange(len(use)) - np.searchsorted(sighting, sighting, side="left")
    held = np.full((count, int(place.max(initial=0)) + 1), NOBODY)
    held[sighting, place] = use
    return held


def _exclusions(facts: _Facts, keyframe: Ints, code: Ints, start: Ints, people: Ints, width: int) -> Words:
    """Per use, the mask of the people at its keyframe of whom the condition is certainly false."""
    count = people[keyframe]
    use = np.repeat(np.arange(len(code)), count)
    slot = np.arange(len(use)) - np.repeat(np.cumsum(count) - count, count)
    who = start[keyframe[use]] + slot
    kind, value = kind_of(code)[use], (code - _FIRST_CODE[kind_of(code)])[use]
    false = np.zeros(len(use), dtype=bool)
    tests: tuple[tuple[int, Callable[[Ints, Ints], Bools]], ...] = (
        # A closed gap of a pose leaves it possible beside the pose that is listed.
        (POSE, lambda w, v: (facts.pose[w] != NOBODY) & (facts.pose[w] != v) & ~facts.maybe[w, v]),
        (ACTION, lambda w, v: facts.listed[w] & ~facts.maybe[w, v + len(POSES)]),
        (SECTOR, lambda w, v: (facts.sector[w] != v) & (facts.sector_other[w] != v)),
        (
            DISTANCE,
            lambda w, v: (facts.distance[w] != NOBODY) & (facts.distance[w] != v) & (facts.distance_other[w] != v),
        ),
        (GROUP_SIZE, lambda w, v: (facts.group_size[w] != NOBODY) & (facts.group_size[w] != v)),
    )
    for number, test in tests:
        chosen = np.flatnonzero(kind == number)
        false[chosen] = test(who[chosen], value[chosen])
    excluded = np.zeros((len(code), width * 64), dtype=bool)
    excluded[use, slot] = false
    return _pack(excluded)


def _pack(bits: Bools) -> Words:
    """Rows of booleans, a multiple of 64 wide, as rows of 64-bit words."""
    packed = np.ascontiguousarray(np.packbits(bits, axis=1, bitorder="little"))
    return packed.view(np.uint64)
