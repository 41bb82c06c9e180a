"""Conditions of people at keyframes: which hold, which certainly do not, and whom each excludes.

A *sighting* is a person with a box at a keyframe. A condition is coded by its place in `Conditions.vocabulary`, which
holds every condition that is true of somebody in the scene; for each sighting it is TRUE, FALSE or UNSURE. A *use*
is a condition at a keyframe, numbered `keyframe * len(vocabulary) + code`. It excludes the people of whom it is
certainly false; those of whom it is not sure could match. Sets of a keyframe's people are bit masks, 64 to a word.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from jrdb_avr.engine.generate.relations import KIND, SOCIAL, Facts, unknown_others
from jrdb_avr.engine.generate.scene import (
    NO_MATCH,
    NOBODY,
    SEVERAL,
    UNDECIDED,
    Ints,
    Scene,
    coded,
    flags,
    handled_categories,
)
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import (
    ACTIONS,
    AGES,
    DISTANCE_WORDS,
    GENDERS,
    INTERACTIONS,
    OTHER_ACTIONS,
    POSES,
    ROBOT_SECTORS,
    may_be_called,
)
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.plan import Attribute, Condition
from jrdb_avr.schema.rules import SLACK, Rules
from jrdb_avr.schema.things import OBJECTS, PERSON_CATEGORIES, VERBS
from jrdb_avr.schema.wording.text import actions_of

Masks = npt.NDArray[np.uint64]
States = npt.NDArray[np.int8]

FALSE, TRUE, UNSURE = 0, 1, 2
"""Whether a condition holds of somebody."""

ANCHOR_TIME: Final = "t0"
"""Name of the time at which the conditions of a description hold."""


@dataclass(frozen=True)
class Conditions:
    """People present at each keyframe, the conditions that hold of them, and the people that these exclude.

    moment, keyframe, slot: per sighting, its moment, its keyframe's number and its place in the masks. states:
    (sightings, codes). held: per sighting the uses by which it may be described, by
    the rules' order of kinds, filled up with NOBODY. rank: per code the place of its kind in that order. everybody: per
    keyframe the mask of all people with a box; slots: per keyframe and slot the moment, NOBODY where there is none.
    """

    scene: Scene
    moment: Ints
    keyframe: Ints
    slot: Ints
    vocabulary: tuple[Condition, ...]
    rank: Ints
    states: States
    held: Ints
    everybody: Masks
    slots: Ints

    @cached_property
    def people(self) -> Ints:
        """Per keyframe, how many people have a box."""
        return np.asarray(np.count_nonzero(self.slots != NOBODY, axis=1), dtype=np.int64)

    @cached_property
    def masks(self) -> Masks:
        """Per use, the mask of the people of whom it is certainly false; a last row, for no use, excludes nobody."""
        return self._masks(FALSE, 0)

    @cached_property
    def sure(self) -> Masks:
        """Per use, the mask of the people of whom it is certainly true; a last row, for no use, is full."""
        return self._masks(TRUE, ~np.uint64(0))

    def _masks(self, state: int, last: int | np.uint64) -> Masks:
        bits = np.zeros((len(self.everybody), len(self.vocabulary), self.slots.shape[1]), dtype=bool)
        sighting, code = np.nonzero(self.states == state)
        bits[self.keyframe[sighting], code, self.slot[sighting]] = True
        masks = packed(bits.reshape(-1, self.slots.shape[1]))
        return np.vstack([masks, np.full((1, masks.shape[1]), last, dtype=np.uint64)])

    def of_kind(self, *kinds: str) -> Bools:
        """Per code, whether it is of one of these kinds."""
        return np.array([condition.kind in kinds for condition in self.vocabulary], dtype=bool)

    @cached_property
    def states_pose(self) -> Bools:
        """Per code, whether its words name a pose."""
        return np.asarray(self.stated_poses.any(axis=1), dtype=bool)

    @cached_property
    def stated_poses(self) -> Bools:
        """(codes, poses): the poses that a condition's words name, as "walking together" names one."""
        stated = [[pose in actions_of(condition) for pose in POSES] for condition in self.vocabulary]
        return np.array(stated, dtype=bool).reshape(-1, len(POSES))

    def code(self, uses: Ints) -> Ints:
        """The place in the vocabulary of each use of a condition."""
        return uses % max(len(self.vocabulary), 1)

    def used(self, uses: Ints) -> tuple[Condition, ...]:
        """The plan's conditions of some uses."""
        return tuple(self.vocabulary[code] for code in self.code(uses[uses != NOBODY]).tolist())

    def any_of(self, which: Bools, uses: Ints) -> Bools:
        """Per set of uses, whether any is of the marked codes."""
        if not len(which):
            return np.zeros(len(uses), dtype=bool)
        return np.asarray(np.any(which[self.code(uses)] & (uses != NOBODY), axis=1))

    @cached_property
    def alone(self) -> Masks:
        """Per sighting, the mask that holds only this person."""
        masks = np.zeros((len(self.moment), self.everybody.shape[1]), dtype=np.uint64)
        masks[np.arange(len(self.moment)), self.slot // 64] = np.uint64(1) << (self.slot % 64).astype(np.uint64)
        return masks

    @cached_property
    def sighting_of(self) -> Ints:
        """Per moment, its sighting, NOBODY where there is no box."""
        sighting = np.full(self.scene.moment_count, NOBODY)
        sighting[self.moment] = np.arange(len(self.moment))
        return sighting

    def could_match(self, keyframe: Ints, uses: Ints) -> Masks:
        """Masks of the people at keyframes whom no use of each set excludes."""
        could: Masks = self.everybody[keyframe]
        for use in np.moveaxis(uses, -1, 0):
            could = could & ~self.masks[use]
        return could

    def matches(self, keyframe: Ints, uses: Ints) -> Ints:
        """The moment of the one person at a keyframe of whom all uses of a set are certainly true while nobody else
        could match; else NO_MATCH, SEVERAL or UNDECIDED."""
        sure: Masks = np.broadcast_to(self.everybody[keyframe], (*uses.shape[:-1], self.everybody.shape[1]))
        for use in np.moveaxis(uses, -1, 0):
            sure = sure & self.sure[use]
        return self.singled_out(keyframe, self.could_match(keyframe, uses), sure)

    def singled_out(self, keyframe: Ints, could: Masks, sure: Masks) -> Ints:
        """The moment of the one person in both masks of a keyframe's people; else NO_MATCH, SEVERAL or UNDECIDED."""
        possible, certain = count(could), count(sure)
        result = np.where(certain >= 2, SEVERAL, np.where(possible == 0, NO_MATCH, UNDECIDED))
        single = (possible == 1) & (certain == 1)
        # The place of the one bit set: how many lie below it, word by word.
        word = could[single].argmax(axis=1)
        bit = np.bitwise_count(could[single][np.arange(len(word)), word] - np.uint64(1)).astype(np.int64)
        result[single] = self.slots[np.broadcast_to(keyframe, single.shape)[single], 64 * word + bit]
        return result

    def members(self, keyframe: int, mask: Masks) -> Ints:
        """Moments of a mask's people, ascending."""
        slots = np.flatnonzero(np.unpackbits(mask.view(np.uint8), bitorder="little"))
        return np.sort(self.slots[keyframe, slots])


class _Column(NamedTuple):
    """A condition, whether it holds for each sighting (true, false, unsure), and which sightings it may describe."""

    condition: Condition
    state: States
    usable: Bools | bool = True


def find_conditions(scene: Scene, facts: Facts, rules: Rules) -> Conditions:
    """All conditions true of somebody at a keyframe of the scene; `facts` are its relations."""
    # By keyframe, then person: people of a keyframe lie side by side and their slots count up.
    place = scene.seen_moments % max(len(scene.keyframes), 1)
    order = np.argsort(place, kind="stable")
    moments, keyframe = scene.seen_moments[order], place[order]
    rows = scene.moment_rows[moments]
    people = np.bincount(keyframe, minlength=len(scene.keyframes))
    slot = np.arange(len(rows)) - (np.cumsum(people) - people)[keyframe]
    slots = np.full((len(scene.keyframes), 64 * max(1, -(-int(people.max(initial=0)) // 64))), NOBODY)
    slots[keyframe, slot] = moments
    columns = [
        column
        for find in (_persons, _actions, _objects, _interactions, _places)
        for column in find(scene, facts, rules, moments, rows)
        if column.condition.kind in rules.condition_order and (column.state == TRUE).any()
    ]
    none = np.zeros((len(rows), 0), dtype=np.int8)
    states = np.column_stack([none, *(column.state for column in columns)])
    usable = np.column_stack([none.astype(bool), *((column.state == TRUE) & column.usable for column in columns)])
    rank = np.array([rules.condition_order.index(column.condition.kind) for column in columns], dtype=np.int64)
    return Conditions(
        scene=scene,
        moment=moments,
        keyframe=keyframe,
        slot=slot,
        vocabulary=tuple(column.condition for column in columns),
        rank=rank,
        states=states,
        held=_held(usable, rank, keyframe),
        everybody=packed(slots != NOBODY),
        slots=slots,
    )


def _held(usable: Bools, rank: Ints, keyframe: Ints) -> Ints:
    """The uses of each sighting as rows of a matrix, ordered by rank and code, filled up with NOBODY."""
    order = np.argsort(rank, kind="stable")
    sighting, place = np.nonzero(usable[:, order])
    column = np.arange(len(sighting)) - np.searchsorted(sighting, sighting, side="left")
    held = np.full((len(usable), int(column.max(initial=0)) + 1), NOBODY)
    held[sighting, column] = keyframe[sighting] * usable.shape[1] + order[place]
    return held


def packed(bits: Bools) -> Masks:
    """Rows of booleans, a multiple of 64 wide, as rows of 64-bit words."""
    return np.ascontiguousarray(np.packbits(bits, axis=1, bitorder="little")).view(np.uint64)


def count(masks: Masks) -> Ints:
    """Number of people in each mask."""
    return np.asarray(np.bitwise_count(masks).sum(axis=-1, dtype=np.int64))


def _state(true: Bools, false: Bools) -> States:
    return np.where(true, TRUE, np.where(false, FALSE, UNSURE)).astype(np.int8)


# -- the kinds --------------------------------------------------------------------------------------------------


def _valued(
    name: Attribute,
    words: Sequence[tuple[int, str | int]],
    value: Ints,
    other: Ints | int = NOBODY,
    at: str | None = ANCHOR_TIME,
    usable: Bools | bool = True,
) -> Iterator[_Column]:
    """Conditions on an attribute, a word each with its number in `value`; NOBODY is unknown.

    other: a second number that is possible too, NOBODY for none. Whoever has another value may have the word said of
    them as well (`may_be_called`).
    """
    for code, word in words:
        true = (value == code) & (other == NOBODY)
        near = [number for number, text in words if text in may_be_called(str(word))]
        state = _state(true, (value != NOBODY) & (value != code) & (other != code) & ~np.isin(value, near))
        yield _Column(Condition(attribute=name, value=word, at=at), state, usable)


def _persons(scene: Scene, facts: Facts, rules: Rules, moments: Ints, rows: Ints) -> Iterator[_Column]:
    """Gender and age; used only of people whose face can be seen, where the pose layer knows."""
    seen = scene.flag("face_visible")[rows] if "pose" in scene.layers else True
    attributes: tuple[tuple[Attribute, tuple[str, ...]], ...] = (("gender", GENDERS), ("age", AGES))
    for name, words in attributes:
        codes = np.full(len(scene.tracks), NOBODY)
        codes[scene.person_of(scene.persons["track"].to_numpy())] = coded(scene.persons[name], words)
        yield from _valued(name, [*enumerate(words)], codes[scene.people(moments)], at=None, usable=seen)


def _actions(scene: Scene, facts: Facts, rules: Rules, moments: Ints, rows: Ints) -> Iterator[_Column]:
    sure = np.zeros((len(ACTIONS), scene.moment_count), dtype=bool)
    maybe = np.zeros_like(sure)
    row, moment = scene.covered(scene.actions, "track")
    action = coded(scene.actions["action"], ACTIONS)[row]
    certain = flags(scene.actions, "certain")[row]
    maybe[action, moment] = True
    sure[action[certain], moment[certain]] = True
    pose, listed = scene.poses[rows], scene.listed[rows]
    for code, word in enumerate(POSES):
        # A closed gap of a pose leaves it possible beside the pose that is listed.
        state = _state(pose == code, (pose != NOBODY) & (pose != code) & ~maybe[code, moments])
        yield _Column(Condition(action=word, at=ANCHOR_TIME), state)
    for code, word in enumerate(OTHER_ACTIONS, start=len(POSES)):
        state = _state(sure[code, moments], listed & ~maybe[code, moments])
        yield _Column(Condition(action=word, at=ANCHOR_TIME), state)


def _objects(scene: Scene, facts: Facts, rules: Rules, moments: Ints, rows: Ints) -> Iterator[_Column]:
    """What is done with a thing of a category; a thing of unknown category could be any."""
    row, moment = scene.covered(scene.handles, "track")
    certain = flags(scene.handles, "certain")[row]
    verb = coded(scene.handles["verb"], VERBS)[row]
    thing = handled_categories(scene)[row]
    listed = scene.flag("handles_listed")[rows]
    for pair in np.unique(np.stack([verb, thing])[:, (verb != NOBODY) & (thing != NOBODY)], axis=1).T.tolist():
        action, category = VERBS[pair[0]], OBJECTS[pair[1]]
        if action in POSES or category in PERSON_CATEGORIES:
            continue
        exact = (verb == pair[0]) & (thing == pair[1])
        could = exact | ((verb == pair[0]) & (thing == NOBODY))
        true, possible = _marked(scene, moment[exact & certain]), _marked(scene, moment[could])
        state = _state(true[moments], listed & ~possible[moments])
        yield _Column(Condition(object=category, verb=action, at=ANCHOR_TIME), state)


def _interactions(scene: Scene, facts: Facts, rules: Rules, moments: Ints, rows: Ints) -> Iterator[_Column]:
    """An interaction with anybody; false where everybody's lists were read and none holds it."""
    social = KIND[facts.relation] == SOCIAL
    if not social.any():
        return
    open_to = unknown_others(scene, facts.known)[SOCIAL]
    for code, label in enumerate(INTERACTIONS):
        of_label = social & (facts.relation == code)
        true = _marked(scene, facts.source[of_label & facts.certain])
        possible = _marked(scene, facts.source[of_label])
        state = _state(true[moments], (open_to[moments] == 0) & ~possible[moments])
        yield _Column(Condition(interaction=label, at=ANCHOR_TIME), state)


def _places(scene: Scene, facts: Facts, rules: Rules, moments: Ints, rows: Ints) -> Iterator[_Column]:
    """Group size, sector and distance word."""
    angle, load = scene.geometry["angle"][rows], rules.load
    for word, axis in ROBOT_SECTORS.items():
        off = angle_error(angle, np.array(axis))
        state = _state(off <= load.sector_true_deg + SLACK, off > load.sector_false_deg + SLACK)
        yield _Column(Condition(attribute="sector", value=word, at=ANCHOR_TIME), state)
    sizes = scene.column("group_size")[rows]
    size = np.where(np.isnan(sizes), NOBODY, sizes).astype(np.int64)
    yield from _valued("group_size", [(number, number) for number in np.unique(size[size != NOBODY]).tolist()], size)
    metres, other = (
        coded(scene.boxes[name], DISTANCE_WORDS)[rows] for name in ("distance_word", "distance_word_other")
    )
    yield from _valued("distance", [*enumerate(DISTANCE_WORDS)], metres, other)


def _marked(scene: Scene, moments: Ints) -> Bools:
    marks = np.zeros(scene.moment_count, dtype=bool)
    marks[moments] = True
    return marks
