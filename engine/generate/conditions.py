"""Conditions of people at keyframes: which hold, which certainly do not, and whom each excludes.

A *sighting* is a person with a box at a keyframe. A condition is coded by its place in `Conditions.vocabulary`, which
holds every condition that is true of somebody in the scene; for each sighting it is TRUE, FALSE or UNKNOWN. A *use*
is a condition at a keyframe, numbered `keyframe * len(vocabulary) + code`. It excludes the people of whom it is
certainly false; those of whom it is unknown could match. Sets of a keyframe's people are bit masks, 64 to a word.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from jrdb_avr.engine.generate.relations import KIND, SOCIAL, Facts, untold_others
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene, coded, flags, moments_of, spread
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
)
from jrdb_avr.schema.plan import Attribute, Condition
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.things import OBJECTS, PERSON_CATEGORIES, VERBS
from jrdb_avr.schema.wording import actions_of

Words = npt.NDArray[np.uint64]
States = npt.NDArray[np.int8]

FALSE, TRUE, UNKNOWN = 0, 1, 2

ANCHOR_TIME: Final = "t0"
"""Name of the time at which the conditions of a description hold."""


@dataclass(frozen=True)
class Conditions:
    """Who is there at each keyframe, what is true of them, and whom that excludes.

    rows, moment, keyframe, slot: per sighting, its row in `boxes`, its moment, its keyframe's number and its place in
    the masks. states: (sightings, codes). held: per sighting the uses by which it may be described, by the rules'
    order of kinds, filled up with NOBODY. rank: per code the place of its kind in that order. everybody: per keyframe
    the mask of all people with a box; slots: per keyframe and slot the moment, NOBODY where there is none.
    """

    rows: Ints
    moment: Ints
    keyframe: Ints
    slot: Ints
    vocabulary: tuple[Condition, ...]
    kinds: tuple[str, ...]
    rank: Ints
    states: States
    held: Ints
    everybody: Words
    slots: Ints

    @cached_property
    def masks(self) -> Words:
        """Per use, the mask of the people of whom it is certainly false."""
        return self._masks(FALSE)

    @cached_property
    def sure(self) -> Words:
        """Per use, the mask of the people of whom it is certainly true."""
        return self._masks(TRUE)

    def _masks(self, state: int) -> Words:
        bits = np.zeros((len(self.everybody), len(self.vocabulary), self.slots.shape[1]), dtype=bool)
        sighting, code = np.nonzero(self.states == state)
        bits[self.keyframe[sighting], code, self.slot[sighting]] = True
        return packed(bits.reshape(-1, self.slots.shape[1]))

    def of_kind(self, *kinds: str) -> Bools:
        """Per code, whether it is of one of these kinds."""
        return np.array([kind in kinds for kind in self.kinds], dtype=bool)

    @cached_property
    def states_pose(self) -> Bools:
        """Per code, whether its words name a pose."""
        return np.asarray(self.stated_poses.any(axis=1), dtype=bool)

    @cached_property
    def stated_poses(self) -> Bools:
        """(codes, poses): the poses that a condition's words name, as "walking together" names one."""
        return np.array(
            [[pose in actions_of(condition) for pose in POSES] for condition in self.vocabulary], dtype=bool
        ).reshape(-1, len(POSES))

    def code(self, uses: Ints) -> Ints:
        """Codes of uses."""
        return uses % max(len(self.vocabulary), 1)

    def condition(self, use: int) -> Condition:
        """The plan's condition of a use."""
        return self.vocabulary[use % len(self.vocabulary)]

    def alone(self) -> Words:
        """Per sighting, the mask that holds only this person."""
        masks = np.zeros((len(self.rows), self.everybody.shape[1]), dtype=np.uint64)
        masks[np.arange(len(self.rows)), self.slot // 64] = np.uint64(1) << (self.slot % 64).astype(np.uint64)
        return masks

    def members(self, keyframe: int, mask: Words) -> Ints:
        """Moments of a mask's people, ascending."""
        slots = np.flatnonzero(np.unpackbits(mask.view(np.uint8), bitorder="little"))
        return np.sort(self.slots[keyframe, slots])


@dataclass(frozen=True)
class _Column:
    """One condition: what it is, its state of every sighting, and whose it may describe."""

    kind: str
    condition: Condition
    state: States
    usable: Bools | None = None


def find_conditions(scene: Scene, facts: Facts, rules: Rules) -> Conditions:
    """All conditions true of somebody at a keyframe of the scene; `facts` are its relations."""
    moments = np.flatnonzero(scene.moment_rows != NOBODY)
    # By keyframe, then person: people of a keyframe lie side by side and their slots count up.
    moments = moments[np.lexsort((moments, moments % len(scene.keyframes)))] if len(moments) else moments
    keyframe = moments % max(len(scene.keyframes), 1)
    rows = scene.moment_rows[moments]
    people = np.bincount(keyframe, minlength=len(scene.keyframes))
    start = np.cumsum(people) - people
    slot = np.arange(len(rows)) - start[keyframe]
    width = 64 * max(1, -(-int(people.max(initial=0)) // 64))
    columns = [
        column
        for find in (_persons, _actions, _objects, _interactions, _places)
        for column in find(scene, facts, moments, rows)
        if column.kind in rules.condition_order and (column.state == TRUE).any()
    ]
    states = np.stack([column.state for column in columns], axis=1) if columns else np.zeros((len(rows), 0), np.int8)
    rank = np.array([rules.condition_order.index(column.kind) for column in columns], dtype=np.int64)
    usable = states == TRUE
    for code, column in enumerate(columns):
        if column.usable is not None:
            usable[:, code] &= column.usable
    slots = np.full((len(scene.keyframes), width), NOBODY)
    slots[keyframe, slot] = moments
    return Conditions(
        rows=rows,
        moment=moments,
        keyframe=keyframe,
        slot=slot,
        vocabulary=tuple(column.condition for column in columns),
        kinds=tuple(column.kind for column in columns),
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


def packed(bits: Bools) -> Words:
    """Rows of booleans, a multiple of 64 wide, as rows of 64-bit words."""
    return np.ascontiguousarray(np.packbits(bits, axis=1, bitorder="little")).view(np.uint64)


def _state(true: Bools, false: Bools) -> States:
    return np.where(true, TRUE, np.where(false, FALSE, UNKNOWN)).astype(np.int8)


# -- the kinds --------------------------------------------------------------------------------------------------


def _persons(scene: Scene, facts: Facts, moments: Ints, rows: Ints) -> Iterator[_Column]:
    """Gender and age; used only of people whose face can be seen, where the pose layer tells."""
    persons = scene.persons(moments)
    seen = scene.flag("face_visible")[rows] if "pose" in scene.layers else None
    attributes: tuple[tuple[Attribute, tuple[str, ...]], ...] = (("gender", GENDERS), ("age", AGES))
    for name, words in attributes:
        value = scene.person_codes(name, words)[persons]
        for code, word in enumerate(words):
            state = _state(value == code, (value != NOBODY) & (value != code))
            yield _Column(name, Condition(attribute=name, value=word), state, seen)


def _actions(scene: Scene, facts: Facts, moments: Ints, rows: Ints) -> Iterator[_Column]:
    sure = np.zeros((len(ACTIONS), scene.moment_count), dtype=bool)
    maybe = np.zeros_like(sure)
    row, keyframe = spread(scene, scene.actions)
    moment = moments_of(scene, scene.actions, "track", row, keyframe)
    action = coded(scene.actions["action"], ACTIONS)[row]
    certain = flags(scene.actions, "certain")[row]
    maybe[action, moment] = True
    sure[action[certain], moment[certain]] = True
    pose, listed = scene.poses[rows], scene.flag("listed")[rows]
    for code, word in enumerate(POSES):
        # A closed gap of a pose leaves it possible beside the pose that is listed.
        state = _state(pose == code, (pose != NOBODY) & (pose != code) & ~maybe[code, moments])
        yield _Column("pose", Condition(action=word, at=ANCHOR_TIME), state)
    for code, word in enumerate(OTHER_ACTIONS, start=len(POSES)):
        state = _state(sure[code, moments], listed & ~maybe[code, moments])
        yield _Column("action", Condition(action=word, at=ANCHOR_TIME), state)


def _objects(scene: Scene, facts: Facts, moments: Ints, rows: Ints) -> Iterator[_Column]:
    """What is done with a thing of a category; a thing of unknown category could be any."""
    row, keyframe = spread(scene, scene.handles)
    moment = moments_of(scene, scene.handles, "track", row, keyframe)
    certain = flags(scene.handles, "certain")[row]
    verb = coded(scene.handles["verb"], VERBS)[row]
    thing = scene.handled_categories[row]
    listed = scene.flag("handles_listed")[rows]
    for pair in np.unique(np.stack([verb, thing])[:, (verb != NOBODY) & (thing != NOBODY)], axis=1).T.tolist():
        action, category = VERBS[pair[0]], OBJECTS[pair[1]]
        if action in POSES or category in PERSON_CATEGORIES:
            continue
        exact = (verb == pair[0]) & (thing == pair[1])
        could = exact | ((verb == pair[0]) & (thing == NOBODY))
        true, possible = _marked(scene, moment[exact & certain]), _marked(scene, moment[could])
        state = _state(true[moments], listed & ~possible[moments])
        yield _Column("object", Condition(object=category, verb=action, at=ANCHOR_TIME), state)


def _interactions(scene: Scene, facts: Facts, moments: Ints, rows: Ints) -> Iterator[_Column]:
    """An interaction with anybody; false where everybody's lists were read and none tells of it."""
    social = KIND[facts.relation] == SOCIAL
    if not social.any():
        return
    open_to = untold_others(scene, facts.told)[SOCIAL]
    for code, label in enumerate(INTERACTIONS):
        of_label = social & (facts.relation == code)
        true = _marked(scene, facts.source[of_label & facts.certain])
        possible = _marked(scene, facts.source[of_label])
        state = _state(true[moments], (open_to[moments] == 0) & ~possible[moments])
        yield _Column("interaction", Condition(interaction=label, at=ANCHOR_TIME), state)


def _places(scene: Scene, facts: Facts, moments: Ints, rows: Ints) -> Iterator[_Column]:
    """Group size, sector and distance word."""
    sizes = scene.column("group_size")[rows]
    size = np.where(np.isnan(sizes), NOBODY, sizes).astype(np.int64)
    for number in np.unique(size[size != NOBODY]).tolist():
        state = _state(size == number, (size != NOBODY) & (size != number))
        yield _Column("group_size", Condition(attribute="group_size", value=number, at=ANCHOR_TIME), state)
    attributes: tuple[tuple[Attribute, str, tuple[str, ...]], ...] = (
        ("sector", "sector", ROBOT_SECTORS),
        ("distance", "distance_word", DISTANCE_WORDS),
    )
    for kind, column, words in attributes:
        value, other = scene.codes(column, words)[rows], scene.codes(f"{column}_other", words)[rows]
        known = value != NOBODY
        for code, word in enumerate(words):
            true = (value == code) & (other == NOBODY)
            state = _state(true, known & (value != code) & (other != code))
            yield _Column(kind, Condition(attribute=kind, value=word, at=ANCHOR_TIME), state)


def _marked(scene: Scene, moments: Ints) -> Bools:
    marks = np.zeros(scene.moment_count, dtype=bool)
    marks[moments] = True
    return marks
