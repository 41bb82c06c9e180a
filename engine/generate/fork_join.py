"""Joins: the one person whom two relations, of two people, single out together, though each alone holds of several.

For every person at a keyframe and every relation that may join, two sets are kept as bit masks, 64 people to a word:
who could have it, and who certainly does. They hold the facts of `relations`, everybody of whom nothing is told, and
the windows, which are worked out here from the centres of all boxes, clear views or not. Whom two relations single out
is then found set-wise, with the people of the plan left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.conditions import Conditions, Words, packed
from jrdb_avr.engine.generate.relations import EMPTY, KIND, RELATIONS, ROBOT_VIEW, SEVERAL, UNKNOWN, Facts
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene
from jrdb_avr.schema.arrays import Bools, Floats
from jrdb_avr.schema.panorama import clockwise
from jrdb_avr.schema.relations import RELATIONS as ROWS
from jrdb_avr.schema.relations import RELATIONS_OF
from jrdb_avr.schema.rules import Rules

JOINING: Final = np.array([RELATIONS.index(label) for label in RELATIONS_OF["join"]], np.int64)
"""Relations that may hold of several people, as indices into RELATIONS."""

_WINDOWS: Final = [row for row in ROWS.values() if row.kind == "window"]
_BLOCK: Final = 1 << 18
"""Pairs of relations looked at in one go."""


@dataclass(frozen=True)
class Joins:
    """Who could and who certainly does have each joining relation with each person at a keyframe.

    row: per moment its row in the masks, NOBODY where there is no box; column: per relation its column, NOBODY where it
    certainly holds of nobody in the scene and so joins nothing; slot: per moment its place in the masks; slots: per
    keyframe and slot the moment; could, sure: (rows, columns, words) of bits by slot.
    """

    row: Ints
    column: Ints
    slot: Ints
    slots: Ints
    could: Words
    sure: Words

    @property
    def relations(self) -> Ints:
        """The relations that join somebody to somebody."""
        return np.flatnonzero(self.column != NOBODY)

    def others(self, source: Ints, relation: Ints, apart: Sequence[Ints]) -> tuple[Words, Words]:
        """Masks of those who could, and who certainly do, have a relation with a person, leaving out some people."""
        place = self.row[source], self.column[relation]
        kept = ~np.bitwise_or.reduce([self._bit(moment) for moment in apart])
        return self.could[place] & kept, self.sure[place] & kept

    def joined(self, b: Ints, r3: Ints, c: Ints, r4: Ints, apart: Sequence[Ints]) -> Ints:
        """The moment of the one person who has both relations, `r3` with `b` and `r4` with `c`, for certain while
        nobody else could; or EMPTY, SEVERAL or UNKNOWN. The people in `apart` do not count."""
        found = np.full(len(b), UNKNOWN)
        for low in range(0, len(b), _BLOCK):
            block = slice(low, low + _BLOCK)
            left_out = [moment[block] for moment in apart]
            could_b, sure_b = self.others(b[block], r3[block], left_out)
            could_c, sure_c = self.others(c[block], r4[block], left_out)
            found[block] = self._only(b[block], could_b & could_c, sure_b & sure_c)
        return found

    def _only(self, at: Ints, could: Words, sure: Words) -> Ints:
        possible, certain = count(could), count(sure)
        found = np.where(certain >= 2, SEVERAL, np.where(possible == 0, EMPTY, UNKNOWN))
        single = np.flatnonzero((possible == 1) & (certain == 1))
        # The place of the one bit set: how many lie below it, word by word.
        word = could[single].argmax(axis=1)
        bit = np.bitwise_count(could[single, word] - np.uint64(1)).astype(np.int64)
        found[single] = self.slots[at[single] % len(self.slots), 64 * word + bit]
        return found

    def _bit(self, moment: Ints) -> Words:
        """Per moment the mask that holds only this person."""
        masks = np.zeros((len(moment), self.could.shape[2]), np.uint64)
        slot = self.slot[moment]
        masks[np.arange(len(moment)), slot // 64] = np.uint64(1) << (slot % 64).astype(np.uint64)
        return masks

    def table(self, a: Ints, b: Ints, c: Ints) -> pa.Table:
        """The graph's table `Joined`: whom the relations of each b and c single out beside each a, where each relation
        alone could hold of two or more. Columns from (b), to (d), a, c, r3, r4."""
        relations = self.relations
        parts: list[tuple[Ints, ...]] = []
        step = max(1, _BLOCK // max(1, len(relations) ** 2))
        for low in range(0, len(a), step):
            people = [moments[low : low + step] for moments in (a, b, c)]
            fork, r3, r4 = self._open(people, relations)
            of_a, of_b, of_c = (moments[fork] for moments in people)
            d = self.joined(of_b, r3, of_c, r4, (of_a, of_b, of_c))
            single = d >= 0
            parts.append(tuple(column[single] for column in (of_b, d, of_a, of_c, r3, r4)))
        none = (np.zeros(0, np.int64),) * 6
        columns = [np.concatenate(column) for column in zip(none, *parts, strict=True)]
        words = pa.array(RELATIONS, pa.string())
        named = [pc.take(words, pa.array(column)) for column in columns[4:]]
        return pa.table([*map(pa.array, columns[:4]), *named], names=["from", "to", "a", "c", "r3", "r4"])

    def _open(self, people: Sequence[Ints], relations: Ints) -> tuple[Ints, Ints, Ints]:
        """(fork, r3, r4) of all pairs of relations that hold of somebody for certain and could of two or more."""
        usable = []
        for source in people[1:]:
            each = np.repeat(np.arange(len(source)), len(relations))
            labels = np.tile(relations, len(source))
            could, sure = self.others(source[each], labels, [moments[each] for moments in people])
            usable.append(((count(could) >= 2) & sure.any(axis=1)).reshape(len(source), len(relations)))
        fork, left, right = np.nonzero(usable[0][:, :, None] & usable[1][:, None, :])
        return fork, relations[left], relations[right]


def count(masks: Words) -> Ints:
    """People in each mask."""
    return np.asarray(np.bitwise_count(masks).sum(axis=-1, dtype=np.int64))


def find_joins(scene: Scene, facts: Facts, conditions: Conditions, rules: Rules) -> Joins:
    """The joining relations of everybody with a box at a keyframe; `facts` are the scene's relations, and `conditions`
    tell who is there."""
    row, slot = np.full((2, scene.moment_count), NOBODY)
    row[conditions.moment] = np.arange(len(conditions.moment))
    slot[conditions.moment] = conditions.slot
    leading = np.unique(facts.relation[facts.certain])
    used = np.union1d(JOINING[np.isin(JOINING, leading)], [RELATIONS.index(row.label) for row in _WINDOWS])
    column = np.full(len(RELATIONS), NOBODY)
    column[used] = np.arange(len(used))
    shape = (len(conditions.moment), len(used), conditions.everybody.shape[1])
    joins = Joins(row, column, slot, conditions.slots, np.zeros(shape, np.uint64), np.zeros(shape, np.uint64))
    _add_facts(joins, facts)
    _add_untold(joins, facts, conditions)
    _add_windows(joins, scene, rules.load.neighbor_margin_deg)
    return joins


def _add_facts(joins: Joins, facts: Facts) -> None:
    usable = joins.column[facts.relation] != NOBODY
    for masks, kept in ((joins.could, usable), (joins.sure, usable & facts.certain)):
        slot = joins.slot[facts.target[kept]]
        place = joins.row[facts.source[kept]], joins.column[facts.relation[kept]], slot // 64
        np.bitwise_or.at(masks, place, np.uint64(1) << (slot % 64).astype(np.uint64))


def _add_untold(joins: Joins, facts: Facts, conditions: Conditions) -> None:
    """Of two people of whom one does not tell, every relation of the kind is possible."""
    there, everybody = joins.slots != NOBODY, conditions.everybody[conditions.keyframe]
    for kind in np.unique(KIND[joins.relations]).tolist():
        if kind == ROBOT_VIEW:
            continue
        told = facts.told[kind]
        silent = packed(there & ~told[joins.slots])[conditions.keyframe]
        open_to = np.where(told[conditions.moment, None], silent, everybody) & ~conditions.alone()
        columns = joins.column[[relation for relation in joins.relations.tolist() if KIND[relation] == kind]]
        joins.could[:, columns] |= open_to[:, None]


def _add_windows(joins: Joins, scene: Scene, margin: float) -> None:
    """Everybody within so many degrees to one side of each person: certain but for those near an edge."""
    for slots in joins.slots:
        people = slots[slots != NOBODY]
        angle = scene.geometry["angle"][scene.moment_rows[people]]
        right: Floats = clockwise(angle[:, None], angle[None, :])
        left = np.where(right > 0, 360.0 - right, 0.0)
        near = np.minimum(left, right) <= margin
        other = ~np.eye(len(people), dtype=bool)
        for window in _WINDOWS:
            turn = left if window.side == "left" else right
            unknown = near | (np.abs(turn - window.degrees) <= margin)
            inside = turn < window.degrees
            at = joins.row[people], joins.column[RELATIONS.index(window.label)]
            joins.could[at] = _wide((inside | unknown) & other, len(slots))
            joins.sure[at] = _wide(inside & ~unknown & other, len(slots))


def _wide(bits: Bools, width: int) -> Words:
    """Rows of bits for the first slots of a keyframe, which are filled without holes, as masks."""
    wide = np.zeros((len(bits), width), bool)
    wide[:, : bits.shape[1]] = bits
    return packed(wide)
