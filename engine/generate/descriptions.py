"""Descriptions: the few conditions that single a person out among everybody with a box at a keyframe.

A set of conditions describes a person when all are true of the person and every other one is excluded by at least one
of them. The shortest wins; ties go by the rules' order of kinds, then by hash. A person has at a keyframe one
description, and one that names no pose (often the same), for questions whose answer is a pose.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import msgspec
import numpy as np
from msgspec.structs import replace

from jrdb_avr.engine.generate.conditions import ANCHOR_TIME, Conditions, count
from jrdb_avr.engine.generate.scene import NOBODY, Ints
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.wording.people import in_order


@dataclass(frozen=True)
class Descriptions:
    """The chosen descriptions of a scene.

    A *name* is the description of a sighting. Per name: its sighting; its uses, filled up with NOBODY; and whether
    it was chosen for questions in general, and for those whose answer is a pose.
    """

    conditions: Conditions
    sighting: Ints
    uses: Ints
    general: Bools
    poseless: Bools
    _look_alikes: dict[int, list[tuple[Condition, list[int]]]] = field(default_factory=dict)

    @cached_property
    def moment(self) -> Ints:
        """Per name, the moment of the person described."""
        return self.conditions.moment[self.sighting]

    @cached_property
    def left(self) -> Ints:
        """(names, conditions): how many people, the target included, could match when the condition is dropped; 0 where
        there is none."""
        keyframe = self.conditions.keyframe[self.sighting]
        others = [np.delete(self.uses, place, axis=1) for place in range(self.uses.shape[1])]
        left = np.stack([count(self.conditions.could_match(keyframe, uses)) for uses in others], axis=1)
        return np.where(self.uses == NOBODY, 0, left)

    def of(self, name: int) -> tuple[Condition, ...]:
        """The conditions of a name, in the order in which they were chosen."""
        return self.conditions.used(self.uses[name])

    def look_alikes(self, name: int) -> list[tuple[Condition, list[int]]]:
        """The conditions of a name, each with the moments of those others who could match without it."""
        if name not in self._look_alikes:
            keyframe, uses, moment = self.conditions.keyframe[self.sighting[name]], self.uses[name], self.moment[name]
            self._look_alikes[name] = []
            for place, condition in enumerate(self.of(name)):
                could = self.conditions.could_match(keyframe, np.delete(uses, place))
                moments = self.conditions.members(int(keyframe), could)
                self._look_alikes[name].append((condition, moments[moments != moment].tolist()))
        return self._look_alikes[name]

    @cached_property
    def stated_poses(self) -> Bools:
        """(names, poses): the poses that a description's words name."""
        stated = np.zeros((len(self.uses), len(POSES)), dtype=bool)
        for column in self.uses.T:
            used = np.flatnonzero(column != NOBODY)
            stated[used] |= self.conditions.stated_poses[self.conditions.code(column[used])]
        return stated

    @cached_property
    def stated_sizes(self) -> Bools:
        """Per name, whether the description states how large the person's group is."""
        return self.conditions.any_of(self.conditions.of_kind("group_size"), self.uses)

    @cached_property
    def texts(self) -> tuple[list[str], Ints]:
        """Distinct sets of conditions, as they stand in a plan's JSON, sorted; and each name's place among them."""
        texts = [conditions_json(self.of(name)) for name in range(len(self.sighting))]
        distinct = sorted(set(texts))
        number = {text: i for i, text in enumerate(distinct)}
        return distinct, np.array([number[text] for text in texts], dtype=np.int64)

    def numbers(self, stated: Iterable[tuple[tuple[Condition, ...], int]]) -> list[int]:
        """Per set of conditions and frame, the number of the name that has them; NOBODY where there is none."""
        texts, place = self.texts
        frames = self.conditions.scene.frames(self.moment)
        known = {(texts[text], frame): i for i, (text, frame) in enumerate(zip(place, frames.tolist(), strict=True))}
        # The layer has one name for the time of a description, whatever the plan calls it.
        return [
            known.get(
                (conditions_json(tuple(c if c.at is None else replace(c, at=ANCHOR_TIME) for c in own)), at), NOBODY
            )
            for own, at in stated
        ]

    @cached_property
    def fits(self) -> Ints:
        """(distinct descriptions, keyframes): whom `Conditions.matches` finds there."""
        conditions = self.conditions
        uses = self.uses[np.unique(self.texts[1], return_index=True)[1]]
        keyframes = np.arange(len(conditions.everybody))
        first_use = keyframes[:, None] * max(len(conditions.vocabulary), 1)
        there = np.where(uses[:, None] == NOBODY, NOBODY, first_use + conditions.code(uses)[:, None])
        return conditions.matches(keyframes, there)


def conditions_json(conditions: tuple[Condition, ...]) -> str:
    """Conditions as they stand in the canonical text of a plan, without the brackets of the list."""
    return msgspec.json.encode(in_order(conditions), order="sorted").decode()[1:-1]


def describe_people(conditions: Conditions, rules: Rules) -> Descriptions:
    """Choose the descriptions of everybody at every keyframe of a scene."""
    sighting, uses = _subsets(conditions, rules)
    best = _best(conditions, sighting, uses, np.arange(len(sighting)))
    poseless = ~conditions.any_of(conditions.states_pose, uses)
    best_poseless = _best(conditions, sighting, uses, np.flatnonzero(poseless))
    chosen = np.union1d(best, best_poseless)
    general, unposed = np.isin(chosen, best), np.isin(chosen, best_poseless)
    return Descriptions(conditions, sighting[chosen], uses[chosen], general, unposed)


# -- choosing -----------------------------------------------------------------------------------------------------


def _subsets(conditions: Conditions, rules: Rules) -> tuple[Ints, Ints]:
    """(sighting, its uses) of every set of conditions that describes, up to the size at which both kinds are found."""
    total, most = conditions.held.shape
    others = conditions.everybody[conditions.keyframe] & ~conditions.alone
    weak = conditions.of_kind("sector", "distance")
    open_general = np.ones(total, dtype=bool)
    open_poseless = np.ones(total, dtype=bool)
    sightings: list[Ints] = [np.zeros(0, dtype=np.int64)]
    columns: list[Ints] = [np.zeros((0, rules.max_conditions), dtype=np.int64)]
    for size in range(1, rules.max_conditions + 1):
        searched = np.flatnonzero(open_general | open_poseless)
        for places in itertools.combinations(range(most), size):
            # Held conditions stand without holes, so the last place decides whether there are as many.
            rows = searched[conditions.held[searched, places[-1]] != NOBODY]
            uses = conditions.held[np.ix_(rows, places)]
            strong = ~np.all(weak[conditions.code(uses)], axis=1)
            rows, uses = rows[strong], uses[strong]
            excluded = np.bitwise_or.reduce(conditions.masks[uses], axis=1)
            alone = np.all((excluded & others[rows]) == others[rows], axis=1)
            rows, uses = rows[alone], uses[alone]
            filled = np.full((len(rows), rules.max_conditions), NOBODY)
            filled[:, :size] = uses
            sightings.append(rows)
            columns.append(filled)
            open_general[rows] = False
            open_poseless[rows[~conditions.any_of(conditions.states_pose, uses)]] = False
    return np.concatenate(sightings), np.concatenate(columns)


def _best(conditions: Conditions, sighting: Ints, uses: Ints, index: Ints) -> Ints:
    """Per sighting the best of these subsets: fewest conditions, then ranks, then hash."""
    size = np.sum(uses[index] != NOBODY, axis=1)
    rank = np.where(uses[index] == NOBODY, 0, conditions.rank[conditions.code(uses[index])])
    order = np.lexsort((*rank.T[::-1], size, sighting[index]))
    index, size, rank = index[order], size[order], rank[order]
    owner, first, group = np.unique(sighting[index], return_index=True, return_inverse=True)
    tied = (size == size[first][group]) & np.all(rank == rank[first][group], axis=1)
    best = index[first]
    several = np.bincount(group[tied], minlength=len(owner)) > 1
    hashes: dict[int, str] = {}
    for place in np.flatnonzero(tied & several[group]).tolist():
        row, who = int(index[place]), int(group[place])
        digest = _tie_hash(conditions, int(sighting[row]), uses[row])
        if who not in hashes or digest < hashes[who]:
            hashes[who] = digest
            best[who] = row
    return best


def _tie_hash(conditions: Conditions, sighting: int, uses: Ints) -> str:
    scene, moment = conditions.scene, int(conditions.moment[sighting])
    frame = int(scene.keyframes[conditions.keyframe[sighting]])
    text = f"{scene.sequence}\n{scene.track(moment)}\n{frame}\n{conditions_json(conditions.used(uses))}"
    return hashlib.sha256(text.encode()).hexdigest()
