"""Descriptions: the few conditions that single a person out among everybody with a box at a keyframe.

A set of conditions describes a person when all are true of the person and every other one is excluded by at least one
of them. The shortest wins; ties go by the rules' order of kinds, then by hash. A person has at a keyframe one
description, and one that names no pose (often the same), for questions that ask for a pose.

Descriptions as plans state them: whom the conditions mean, found without asking how they were chosen.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.conditions import ANCHOR_TIME, Conditions, Words, find_conditions
from jrdb_avr.engine.generate.relations import EMPTY, SEVERAL, UNKNOWN, Facts
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.wording import in_order


@dataclass(frozen=True)
class Descriptions:
    """The chosen descriptions of a scene.

    A *name* is a description given to a sighting. Per name: its moment; its uses, filled up with NOBODY; `left`, how
    many people, the target included, could match when each of its conditions is dropped; and whether it was chosen for
    questions in general, and for those that ask for a pose.
    """

    conditions: Conditions
    sighting: Ints
    moment: Ints
    uses: Ints
    left: Ints
    general: Bools
    poseless: Bools

    def anchor(self) -> Bools:
        """Whether every condition is needed: two or more people could match without it."""
        return np.asarray(np.all((self.left >= 2) | (self.uses == NOBODY), axis=1))

    def of(self, name: int) -> tuple[Condition, ...]:
        """The conditions of a name, in the order in which they were chosen."""
        return tuple(self.conditions.condition(int(use)) for use in self.uses[name] if use != NOBODY)

    def look_alikes(self, name: int) -> list[Ints]:
        """Per condition of a name: moments of those who could match without it, the target's among them."""
        keyframe = int(self.conditions.keyframe[self.sighting[name]])
        uses = [use for use in self.uses[name] if use != NOBODY]
        return [
            self.conditions.members(keyframe, _could_match(self.conditions, keyframe, [u for u in uses if u != use]))
            for use in uses
        ]

    @cached_property
    def stated_poses(self) -> Bools:
        """(names, poses): the poses that a description's words name."""
        stated = np.zeros((len(self.uses), len(POSES)), dtype=bool)
        for column in self.uses.T:
            told = np.flatnonzero(column != NOBODY)
            stated[told] |= self.conditions.stated_poses[self.conditions.code(column[told])]
        return stated

    @cached_property
    def stated_sizes(self) -> Bools:
        """Per name, whether the description says how large the person's group is."""
        return _any(self.conditions, self.conditions.of_kind("group_size"), self.uses)

    @cached_property
    def texts(self) -> tuple[list[str], Ints]:
        """Distinct sets of conditions, as they stand in a plan's JSON, sorted; and each name's place among them."""
        texts = [conditions_json(self.of(name)) for name in range(len(self.moment))]
        distinct = sorted(set(texts))
        number = {text: i for i, text in enumerate(distinct)}
        return distinct, np.array([number[text] for text in texts], dtype=np.int64)

    def tables(self, keyframes: Ints) -> dict[str, pa.Table]:
        """The graph's tables `Description`, `Names` and `Fits`; `keyframes` are the frames of the scene's."""
        distinct, number = self.texts
        names = {
            "from": number,
            "to": self.moment,
            "id": np.arange(len(number)),
            "anchor": self.anchor(),
            "general": self.general,
            "poseless": self.poseless,
        }
        nodes = {"id": np.arange(len(distinct)), "conditions": pa.array(distinct, pa.string())}
        fits = {
            "from": np.repeat(np.arange(len(distinct)), len(keyframes)),
            "to": self.fits.ravel(),
            "t": np.tile(keyframes, len(distinct)),
        }
        return {"Description": pa.table(nodes), "Names": pa.table(names), "Fits": pa.table(fits)}

    @cached_property
    def fits(self) -> Ints:
        """(distinct descriptions, keyframes): the moment of the one person who certainly matches while nobody else
        could, or EMPTY, SEVERAL or UNKNOWN."""
        conditions = self.conditions
        distinct, number = self.texts
        one_name = np.unique(number, return_index=True)[1]
        uses = self.uses[one_name]
        codes = np.where(uses == NOBODY, NOBODY, conditions.code(uses))
        at = np.arange(len(conditions.everybody)) * max(len(conditions.vocabulary), 1)
        could = np.repeat(conditions.everybody[None], len(distinct), axis=0)
        sure = could.copy()
        for column in codes.T:
            stated = np.flatnonzero(column != NOBODY)
            use = at[None, :] + column[stated, None]
            could[stated] &= ~conditions.masks[use]
            sure[stated] &= conditions.sure[use]
        possible, certain = (np.bitwise_count(mask).sum(axis=2, dtype=np.int64) for mask in (could, sure))
        result = np.where(certain >= 2, SEVERAL, np.where(possible == 0, EMPTY, UNKNOWN))
        single = np.nonzero((possible == 1) & (certain == 1))
        bits = np.unpackbits(could[single].view(np.uint8), axis=1, bitorder="little")
        result[single] = conditions.slots[single[1], bits.argmax(axis=1)] if len(bits) else NOBODY
        return np.asarray(result)


def conditions_json(conditions: tuple[Condition, ...]) -> str:
    """Conditions as they stand in the canonical text of a plan, without the brackets of the list."""
    return msgspec.json.encode(in_order(conditions), order="sorted").decode()[1:-1]


def describe_people(scene: Scene, facts: Facts, rules: Rules) -> Descriptions:
    """Choose the descriptions of everybody at every keyframe of a scene; `facts` are its relations."""
    conditions = find_conditions(scene, facts, rules)
    sighting, columns = _subsets(conditions, rules)
    poseless = ~_any(conditions, conditions.states_pose, columns)
    best = _best(scene, conditions, sighting, columns, np.ones(len(sighting), dtype=bool))
    best_poseless = _best(scene, conditions, sighting, columns, poseless)
    chosen = np.union1d(best, best_poseless)
    return Descriptions(
        conditions=conditions,
        sighting=sighting[chosen],
        moment=conditions.moment[sighting[chosen]],
        uses=columns[chosen],
        left=_left(conditions, sighting[chosen], columns[chosen]),
        general=np.isin(chosen, best),
        poseless=np.isin(chosen, best_poseless),
    )


def _subsets(conditions: Conditions, rules: Rules) -> tuple[Ints, Ints]:
    """(sighting, its uses) of every set of conditions that describes, up to the size at which both kinds are found."""
    count, most = conditions.held.shape
    others = conditions.everybody[conditions.keyframe] & ~conditions.alone()
    weak = conditions.of_kind("sector", "distance")
    is_pose = conditions.states_pose
    open_general = np.ones(count, dtype=bool)
    open_poseless = np.ones(count, dtype=bool)
    sightings: list[Ints] = [np.zeros(0, dtype=np.int64)]
    columns: list[Ints] = [np.zeros((0, rules.max_conditions), dtype=np.int64)]
    for size in range(1, rules.max_conditions + 1):
        searched = np.flatnonzero(open_general | open_poseless)
        for places in itertools.combinations(range(most), size):
            # Held conditions stand without holes, so the last place decides whether there are as many.
            rows = searched[conditions.held[searched, places[-1]] != NOBODY]
            uses = conditions.held[np.ix_(rows, places)]
            rows, uses = _kept(rows, uses, ~np.all(weak[conditions.code(uses)], axis=1))
            excluded = np.bitwise_or.reduce(conditions.masks[uses], axis=1)
            alone = np.all((excluded & others[rows]) == others[rows], axis=1)
            rows, uses = _kept(rows, uses, alone)
            filled = np.full((len(rows), rules.max_conditions), NOBODY)
            filled[:, :size] = uses
            sightings.append(rows)
            columns.append(filled)
            open_general[rows] = False
            open_poseless[rows[~np.any(is_pose[conditions.code(uses)], axis=1)]] = False
    return np.concatenate(sightings), np.concatenate(columns)


def _any(conditions: Conditions, which: Bools, uses: Ints) -> Bools:
    """Per set of uses, whether any is of the codes marked."""
    if not len(which):
        return np.zeros(len(uses), dtype=bool)
    return np.asarray(np.any(which[conditions.code(uses)] & (uses != NOBODY), axis=1))


def _kept(rows: Ints, uses: Ints, which: Bools) -> tuple[Ints, Ints]:
    return rows[which], uses[which]


def _best(scene: Scene, conditions: Conditions, sighting: Ints, uses: Ints, allowed: Bools) -> Ints:
    """Per sighting the index of its best allowed subset: fewest conditions, then ranks, then hash."""
    index = np.flatnonzero(allowed)
    size = np.sum(uses[index] != NOBODY, axis=1)
    rank = np.where(uses[index] == NOBODY, 0, conditions.rank[conditions.code(uses[index])])
    keys = [rank[:, place] for place in reversed(range(rank.shape[1]))]
    order = np.lexsort((*keys, size, sighting[index]))
    index, size, rank = index[order], size[order], rank[order]
    owner, first, group = np.unique(sighting[index], return_index=True, return_inverse=True)
    tied = (size == size[first][group]) & np.all(rank == rank[first][group], axis=1)
    best = index[first]
    several = np.bincount(group[tied], minlength=len(owner)) > 1
    hashes: dict[int, str] = {}
    for place in np.flatnonzero(tied & several[group]).tolist():
        row, who = int(index[place]), int(group[place])
        text = _tie_text(scene, conditions, int(sighting[row]), uses[row])
        digest = hashlib.sha256(text.encode()).hexdigest()
        if who not in hashes or digest < hashes[who]:
            hashes[who] = digest
            best[who] = row
    return best


def _tie_text(scene: Scene, conditions: Conditions, sighting: int, uses: Ints) -> str:
    keyframe = int(conditions.keyframe[sighting])
    track = int(scene.tracks[scene.persons(conditions.moment[sighting])])
    used = tuple(conditions.condition(int(use)) for use in uses if use != NOBODY)
    return f"{scene.sequence}\n{track}\n{int(scene.keyframes[keyframe])}\n{conditions_json(used)}"


def _could_match(conditions: Conditions, keyframe: int, uses: list[int]) -> Words:
    """Mask of the people at a keyframe whom none of these uses excludes."""
    excluded = np.bitwise_or.reduce(conditions.masks[uses], axis=0) if uses else np.uint64(0)
    return np.asarray(conditions.everybody[keyframe] & ~excluded)


def _left(conditions: Conditions, sighting: Ints, uses: Ints) -> Ints:
    """Per name and condition: how many people could match when it is dropped; 0 where there is no condition."""
    everybody = conditions.everybody[conditions.keyframe[sighting]]
    left = np.zeros(uses.shape, dtype=np.int64)
    # A last row of zeros stands for "no condition": it excludes nobody.
    masks = np.vstack([conditions.masks, np.zeros((1, everybody.shape[1]), dtype=np.uint64)])
    for place in range(uses.shape[1]):
        kept = np.delete(uses, place, axis=1)
        excluded = np.bitwise_or.reduce(masks[kept], axis=1) if kept.shape[1] else np.zeros_like(everybody)
        remaining = np.bitwise_count(everybody & ~excluded).sum(axis=1)
        left[:, place] = np.where(uses[:, place] == NOBODY, 0, remaining)
    return left


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
    could = _could_match_described(conditions, keyframe, uses)
    sure = conditions.everybody[keyframe].copy()
    for use in uses:
        sure &= conditions.sure[use]
    if _count(could) != 1 or _count(sure) != 1:
        return NOBODY
    [moment] = conditions.members(keyframe, could).tolist()
    return int(np.flatnonzero(conditions.moment == moment)[0])


def _could_match_described(conditions: Conditions, keyframe: int, uses: Sequence[int]) -> Words:
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
            left[row, place] = _count(
                _could_match_described(conditions, keyframe, [other for other in own if other != use])
            )
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
