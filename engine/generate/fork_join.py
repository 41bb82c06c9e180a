"""Fork-joins: two people reached from the one described, and the fourth whom a relation of each singles out together,
though each relation alone holds of several; with the proofs that no part of this can be left out.

For every person at a keyframe and every relation that may join, there are two sets as bit masks, 64 people to a word:
who could have it, and who certainly does. They hold the facts of `relations`, everybody of whom nothing is known, and
the windows, which are worked out here from the centres of all boxes, clear views or not. Whom two relations single out
is then found set-wise, with the people of the plan left out.

The walks run in the stored graph, along `Step` and `Fits`; the joins at their ends are read from the masks. The hops
of a fork are numbered as its edges are: 1 and 2 lead to b and c, 3 and 4 join d to them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.candidates import Candidates, Codes, Effect, PerturbationResult, compared
from jrdb_avr.engine.generate.chains import beyond, path_rows
from jrdb_avr.engine.generate.conditions import Conditions, Masks, count, packed
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.keyframes import OUTCOMES_NOWHERE, shift_frames
from jrdb_avr.engine.generate.relations import KIND, RELATIONS, ROBOT_VIEW, Facts
from jrdb_avr.engine.generate.scene import (
    NO_MATCH,
    NOBODY,
    NOWHERE,
    SEVERAL,
    UNDECIDED,
    Ints,
    Scene,
    coded,
    ints,
    masked,
    named,
)
from jrdb_avr.schema.panorama import clockwise
from jrdb_avr.schema.relations import RELATIONS as ROWS
from jrdb_avr.schema.relations import RELATIONS_OF

JOINING: Final = np.array([RELATIONS.index(label) for label in RELATIONS_OF["join"]], np.int64)
"""Relations that may hold of several people, as indices into RELATIONS."""

_WINDOWS: Final = [row for row in ROWS.values() if row.kind == "window"]
_BLOCK: Final = 1 << 18
"""Pairs of relations looked at in one go."""


@dataclass(frozen=True)
class Joins:
    """Who could and who certainly does have each joining relation with each person at a keyframe.

    column: per relation its column, NOBODY where it certainly holds of nobody in the scene and so joins nothing;
    could, sure: (sightings, columns, words) of bits.
    """

    conditions: Conditions
    column: Ints
    could: Masks
    sure: Masks

    @property
    def relations(self) -> Ints:
        """The relations that join somebody to somebody."""
        return np.flatnonzero(self.column != NOBODY)

    def others(self, source: Ints, relation: Ints, apart: Sequence[Ints]) -> tuple[Masks, Masks]:
        """Masks of those who could, and who certainly do, have a relation with a person, leaving out some people."""
        sighting_of, alone = self.conditions.sighting_of, self.conditions.alone
        place = sighting_of[source], self.column[relation]
        others = ~np.bitwise_or.reduce([alone[sighting_of[moment]] for moment in apart])
        return self.could[place] & others, self.sure[place] & others

    def joined(self, b: Ints, r3: Ints, c: Ints, r4: Ints, apart: Sequence[Ints]) -> Ints:
        """The moment of the one person who has both relations, `r3` with `b` and `r4` with `c`, for certain while
        nobody else could; or NO_MATCH, SEVERAL or UNDECIDED. The people in `apart` do not count."""
        found = np.full(len(b), UNDECIDED)
        for low in range(0, len(b), _BLOCK):
            block = slice(low, low + _BLOCK)
            left_out = [moment[block] for moment in apart]
            could_b, sure_b = self.others(b[block], r3[block], left_out)
            could_c, sure_c = self.others(c[block], r4[block], left_out)
            keyframe = b[block] % len(self.conditions.slots)
            found[block] = self.conditions.singled_out(keyframe, could_b & could_c, sure_b & sure_c)
        return found

    def table(self, a: Ints, b: Ints, c: Ints) -> pa.Table:
        """The graph's table `Joined`: whom the relations of each b and c single out beside each a, where each relation
        alone could hold of two or more. Columns from (b), to (d), a, c, r3, r4."""
        parts = [np.zeros((6, 0), np.int64)]
        step = max(1, _BLOCK // max(1, len(self.relations) ** 2))
        for low in range(0, len(a), step):
            people = [moments[low : low + step] for moments in (a, b, c)]
            fork, r3, r4 = self._open(people)
            of_a, of_b, of_c = (moments[fork] for moments in people)
            d = self.joined(of_b, r3, of_c, r4, (of_a, of_b, of_c))
            parts.append(np.stack([of_b, d, of_a, of_c, r3, r4])[:, d >= 0])
        columns = np.concatenate(parts, axis=1)
        names = ["from", "to", "a", "c", "r3", "r4"]
        return pa.table([*map(pa.array, columns[:4]), *(named(r, RELATIONS) for r in columns[4:])], names=names)

    def _open(self, people: Sequence[Ints]) -> tuple[Ints, Ints, Ints]:
        """(fork, r3, r4) of all pairs of relations that hold of somebody for certain and could of two or more."""
        usable = []
        relations = self.relations
        for source in people[1:]:
            each = np.repeat(np.arange(len(source)), len(relations))
            labels = np.tile(relations, len(source))
            could, sure = self.others(source[each], labels, [moments[each] for moments in people])
            usable.append(((count(could) >= 2) & sure.any(axis=1)).reshape(len(source), len(relations)))
        fork, left, right = np.nonzero(usable[0][:, :, None] & usable[1][:, None, :])
        return fork, relations[left], relations[right]


# -- who has which relation ---------------------------------------------------------------------------------------


def find_joins(context: SearchContext) -> Joins:
    """The joining relations of everybody with a box at a keyframe."""
    facts, conditions = context.facts, context.conditions
    leading = np.unique(facts.relation[facts.certain])
    used = np.union1d(JOINING[np.isin(JOINING, leading)], [RELATIONS.index(row.label) for row in _WINDOWS])
    column = np.full(len(RELATIONS), NOBODY)
    column[used] = np.arange(len(used))
    shape = (len(conditions.moment), len(used), conditions.everybody.shape[1])
    joins = Joins(conditions, column, np.zeros(shape, np.uint64), np.zeros(shape, np.uint64))
    _add_facts(joins, facts)
    _add_unknown(joins, facts)
    _add_windows(joins, context.rules.load.neighbor_margin_deg)
    return joins


def _add_facts(joins: Joins, facts: Facts) -> None:
    conditions, usable = joins.conditions, joins.column[facts.relation] != NOBODY
    for masks, rows in ((joins.could, usable), (joins.sure, usable & facts.certain)):
        source, target = (conditions.sighting_of[moment[rows]] for moment in (facts.source, facts.target))
        slot = conditions.slot[target]
        place = source, joins.column[facts.relation[rows]], slot // 64
        np.bitwise_or.at(masks, place, np.uint64(1) << (slot % 64).astype(np.uint64))


def _add_unknown(joins: Joins, facts: Facts) -> None:
    """Of two people of whom one is not known, every relation of the kind is possible."""
    conditions = joins.conditions
    there, everybody = conditions.slots != NOBODY, conditions.everybody[conditions.keyframe]
    for kind in np.unique(KIND[joins.relations]).tolist():
        if kind == ROBOT_VIEW:
            continue
        known = facts.known[kind]
        silent = packed(there & ~known[conditions.slots])[conditions.keyframe]
        open_to = np.where(known[conditions.moment, None], silent, everybody) & ~conditions.alone
        columns = joins.column[joins.relations[KIND[joins.relations] == kind]]
        joins.could[:, columns] |= open_to[:, None]


def _add_windows(joins: Joins, margin: float) -> None:
    """Everybody within so many degrees to one side of each person: certain but for those near an edge."""
    conditions = joins.conditions
    scene = conditions.scene
    for slots in conditions.slots:
        people = slots[slots != NOBODY]
        if not len(people):
            continue
        # Of a slot without a person the angle is anybody's, and is masked out.
        angle = scene.geometry["angle"][scene.moment_rows[slots]]
        right = clockwise(angle[: len(people), None], angle[None, :])
        left = np.where(right > 0, 360.0 - right, 0.0)
        near = np.minimum(left, right) <= margin
        other = (slots != NOBODY) & (slots != people[:, None])
        for window in _WINDOWS:
            turn = left if window.side == "left" else right
            unknown = near | (np.abs(turn - window.degrees) <= margin)
            inside = turn < window.degrees
            at = conditions.sighting_of[people], joins.column[RELATIONS.index(window.label)]
            joins.could[at] = packed((inside | unknown) & other)
            joins.sure[at] = packed(inside & ~unknown & other)


# -- candidates and proofs ----------------------------------------------------------------------------------------


def fork_proofs(context: SearchContext, paths: Candidates) -> list[PerturbationResult]:
    """hop.skip of every hop, and time.shift and time.drop of the whole program."""
    joins = find_joins(context)

    def read(people: Sequence[Ints], apart: Sequence[Ints] | None = None, rows: Candidates = paths) -> Read:
        return _poses(context, rows, _joined(joins, rows, people, people if apart is None else apart))

    a, b, c = (paths.people[node] for node in "abc")
    proofs = [
        PerturbationResult("hop.skip", "1", *read((a, a, c), (a, c))),
        PerturbationResult("hop.skip", "2", *read((a, b, a), (a, b))),
    ]
    for skipped, source, relation in (("3", c, "r4"), ("4", b, "r3")):
        # What is left holds of the target, so nobody else for certain means that it cannot be decided.
        _, sure = joins.others(source, paths.relations[relation], (a, b, c))
        reached = np.where(count(sure) >= 2, SEVERAL, UNDECIDED)
        proofs.append(PerturbationResult("hop.skip", skipped, *_poses(context, paths, reached)))
    for by in shift_frames(context.rules):
        found = context.query("necessity", "fork_join_shift", by=by)
        found = found.take(masked(path_rows(paths, found)))
        moved = paths.frames["t0"] + by
        outcome, answer = read([_reached(context.scene, found, node, moved) for node in "abc"])
        proofs.append(PerturbationResult.of_shift(by, outcome, answer, beyond(context, moved)))
    return [*proofs, _drop(context, paths, read)]


Read = tuple[Codes, Codes]
"""Effect and answer of a perturbed program, per candidate."""


def _poses(context: SearchContext, paths: Candidates, moment: Ints) -> Read:
    """Effect and answer of reading the poses of these people, by their moments, in place of the candidates' targets."""
    answer = np.where(moment < 0, NOBODY, context.scene.moment_poses[moment]).astype(np.int8)
    nobody = [moment == NO_MATCH, moment == SEVERAL]
    return np.select(nobody, [Effect.EMPTY, Effect.AMBIGUOUS], compared(answer, paths.answer)).astype(np.int8), answer


def _reached(scene: Scene, found: pa.Table, node: str, frames: Ints) -> Ints:
    """The moment at these frames of whom a query's rows reach, or the number of the outcome."""
    track, outcome = ints(found, node), coded(found[f"{node}_outcome"], OUTCOMES_NOWHERE)
    nowhere = np.array([*NOWHERE, UNDECIDED])[outcome]
    return np.where(track == NOBODY, nowhere, scene.moments(track, np.minimum(frames, scene.keyframes[-1])))


def _drop(context: SearchContext, paths: Candidates, read: Callable[..., Read]) -> PerturbationResult:
    """The answers at every keyframe at which description and first steps lead to two people."""
    found = context.query("necessity", "fork_join_drop")
    codes = [coded(found[name], RELATIONS) for name in ("r1", "r2")]
    key, keys = (
        (description * len(RELATIONS) + r1) * len(RELATIONS) + r2
        for description, r1, r2 in (
            (context.descriptions.texts[1][paths.name], paths.relations["r1"], paths.relations["r2"]),
            (ints(found, "description"), *codes),
        )
    )
    order = np.argsort(keys, kind="stable")
    low, high = (np.searchsorted(keys[order], key, side=side) for side in ("left", "right"))
    number = np.repeat(np.arange(len(paths)), high - low)
    row = order[np.arange(len(number)) - np.repeat(np.cumsum(high - low) - high, high - low)]
    people = [context.scene.moments(ints(found, node), ints(found, "frame"))[row] for node in "abc"]
    outcome, _ = read(people, rows=paths.take(number))
    different = outcome == Effect.DIFFERENT
    known = different | (outcome == Effect.SAME)
    defined, others = (np.bincount(number[which], minlength=len(paths)) for which in (known, different))
    return PerturbationResult.of_drop(defined, 1 + (others > 0))


def _joined(joins: Joins, paths: Candidates, people: Sequence[Ints], apart: Sequence[Ints]) -> Ints:
    """Where programs end whose a, b and c are these people, or nobody for a reason, while those in `apart` are no d.

    The branches have no order: where one leads to nobody there is no d, whatever the other does.
    """
    a, b, c = people
    d = np.full(len(paths), UNDECIDED)
    for why in (SEVERAL, NO_MATCH):
        d[(b == why) | (c == why)] = why
    d[a < 0] = a[a < 0]
    there = (a >= 0) & (b >= 0) & (c >= 0)
    d[there & (b == c)] = NO_MATCH
    rows = np.flatnonzero(there & (b != c))
    r3, r4 = (paths.relations[name][rows] for name in ("r3", "r4"))
    d[rows] = joins.joined(b[rows], r3, c[rows], r4, [moments[rows] for moments in apart])
    return d
