"""Relations between people at keyframes, as facts of three values and as steps from one person to the next.

A *fact* joins two moments of one keyframe: certain, or possible (a hard label, a closed gap, an edge of a sector).
Where a person's list was not read, or a 3D box has no lidar points, every relation of that kind with anybody is
possible. A *step* is what a relation leads to from a moment: the one person who certainly has it while nobody else
could, or the reason why there is none. Every moment has a step for every relation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.scene import NOBODY, NOWHERE, Ints, Scene, coded, flags, moments_of, spread
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.relations import LAYER_OF_KIND, QUESTION_RELATIONS, SAME_GROUP
from jrdb_avr.schema.relations import RELATIONS as ROWS
from jrdb_avr.schema.wording import poses_of

SOCIAL, GROUP, ROBOT_VIEW, PERSON_VIEW = range(4)
"""Layers that tell relations: what is unknown of a person is unknown for all relations of a layer."""

_LAYERS: Final = ("interactions", "groups", "2d", "3d")

RELATIONS: Final = QUESTION_RELATIONS
"""Relations that a question may name; coded columns are indices into it. Of windows, which hold of several people,
there are no facts here and no steps: see `fork_join`."""

KIND: Final = np.array([_LAYERS.index(LAYER_OF_KIND[ROWS[label].kind]) for label in RELATIONS], np.int64)

STATED_POSES: Final = np.array([[pose in poses_of(relation) for pose in POSES] for relation in RELATIONS])
"""(relations, poses): the poses that a relation's words name."""

EMPTY, SEVERAL, UNKNOWN = NOWHERE
"""Steps that lead to nobody: nobody could match, two or more certainly do, or it cannot be told."""


@dataclass(frozen=True)
class Facts:
    """Every pair of moments with a relation that is or could be, once per relation.

    told (kinds, moments): whether a moment tells who its partners in a kind are. Of two people of whom one does not
    tell, every relation of the kind that has no fact is unknown.
    """

    source: Ints
    relation: Ints
    target: Ints
    certain: Bools
    told: Bools


@dataclass(frozen=True)
class Steps:
    """For every moment with a box and every relation that leads anywhere in the scene: its target, or EMPTY, ..."""

    source: Ints
    relation: Ints
    target: Ints

    def tables(self) -> dict[str, pa.Table]:
        """The graph's tables `Step` and, of those that lead to somebody, `Leads`.

        Where a step leads to nobody, all further steps do.
        """
        leading = np.unique(self.relation)
        ends = np.repeat(np.array(NOWHERE), len(leading))
        relation = np.concatenate([self.relation, np.tile(leading, len(NOWHERE))])
        steps = pa.table(
            {
                "from": np.concatenate([self.source, ends]),
                "to": np.concatenate([self.target, ends]),
                "relation": pc.take(pa.array(RELATIONS, pa.string()), pa.array(relation)),
            }
        )
        return {"Step": steps, "Leads": steps.filter(pc.greater_equal(steps["to"], 0))}


def find_facts(scene: Scene) -> Facts:
    """All relations at the keyframes of a scene, between people with a box there."""
    parts = [
        _pairs_of(scene, scene.interactions),
        _pairs_of(scene, scene.beside),
        _groups(scene),
    ]
    source, relation, target, certain = (np.concatenate([part[i] for part in parts]) for i in range(4))
    # A pair may have a row by each of two spans: what is certain by one of them is certain.
    key = (source * len(RELATIONS) + relation) * scene.moment_count + target
    order = np.lexsort((~certain, key))
    kept = order[np.flatnonzero(np.r_[True, key[order][1:] != key[order][:-1]][: len(order)])]
    return Facts(source[kept], relation[kept], target[kept], certain[kept], _told(scene))


def find_steps(scene: Scene, facts: Facts) -> Steps:
    """The step of every moment with a box by every relation that leads to somebody anywhere."""
    cell = facts.source * len(RELATIONS) + facts.relation
    cells, first, place, rows = np.unique(cell, return_index=True, return_inverse=True, return_counts=True)
    owner, relation = cells // len(RELATIONS), cells % len(RELATIONS)
    kind = KIND[facts.relation]
    # Those of whom nothing is known count beside those who have a fact, and are not counted twice.
    untold = ~(facts.told[kind, facts.source] & facts.told[kind, facts.target])
    others = untold_others(scene, facts.told)
    could = rows + others[KIND[relation], owner] - np.bincount(place, weights=untold, minlength=len(cells))
    sure = np.bincount(place, weights=facts.certain, minlength=len(cells))
    single = (could == 1) & (sure == 1)
    target = np.where(single, facts.target[first], np.where(sure >= 2, SEVERAL, UNKNOWN))
    leading = np.unique(relation[single])
    moments = np.flatnonzero(scene.moment_rows != NOBODY)
    source, by = np.repeat(moments, len(leading)), np.tile(leading, len(moments))
    result = np.where(others[KIND[by], source] > 0, UNKNOWN, EMPTY)
    if len(cells):
        wanted = source * len(RELATIONS) + by
        at = np.minimum(np.searchsorted(cells, wanted), len(cells) - 1)
        result = np.where(cells[at] == wanted, target[at], result)
    return Steps(source, by, result)


def untold_others(scene: Scene, told: Bools) -> Ints:
    """(kinds, moments): with how many others every relation of a kind is possible for want of knowledge."""
    there = scene.moment_rows != NOBODY
    keyframe = np.arange(scene.moment_count) % max(len(scene.keyframes), 1)
    people = np.bincount(keyframe[there], minlength=len(scene.keyframes))
    result = np.zeros(told.shape, np.int64)
    for kind in range(len(told)):
        silent = np.bincount(keyframe[there & ~told[kind]], minlength=len(scene.keyframes))
        result[kind] = np.where(told[kind], silent[keyframe], people[keyframe] - 1)
    return result


def _told(scene: Scene) -> Bools:
    told = np.ones((len(_LAYERS), scene.moment_count), bool)
    there = np.flatnonzero(scene.moment_rows != NOBODY)
    rows = scene.moment_rows[there]
    told[SOCIAL, there] = scene.flag("interactions_listed")[rows]
    told[PERSON_VIEW, there] = scene.flag("located")[rows]
    row, keyframe = spread(scene, scene.memberships)
    told[GROUP] = False
    told[GROUP, moments_of(scene, scene.memberships, "track", row, keyframe)] = True
    return told


# -- facts by kind ----------------------------------------------------------------------------------------------

_Part = tuple[Ints, Ints, Ints, Bools]


def _pairs_of(scene: Scene, table: pa.Table) -> _Part:
    """Facts of a table of labelled spans between a source and a target track; unknown labels are left out."""
    codes = coded(table["label"], RELATIONS)
    row, keyframe = spread(scene, table)
    known = codes[row] != NOBODY
    row, keyframe = row[known], keyframe[known]
    source, target = (moments_of(scene, table, who, row, keyframe) for who in ("source", "target"))
    there = (scene.moment_rows[source] != NOBODY) & (scene.moment_rows[target] != NOBODY)
    certain = flags(table, "certain")[row]
    return source[there], codes[row][there], target[there], certain[there]


def _groups(scene: Scene) -> _Part:
    """Pairs of members of one cluster: certain where both memberships are."""
    table = scene.memberships
    row, keyframe = spread(scene, table)
    moment = moments_of(scene, table, "track", row, keyframe)
    there = scene.moment_rows[moment] != NOBODY
    row, keyframe, moment = row[there], keyframe[there], moment[there]
    cluster = np.unique(table["cluster"].to_numpy(), return_inverse=True)[1][row]
    certain = flags(table, "certain")[row]
    group = keyframe * (int(cluster.max(initial=0)) + 1) + cluster
    order = np.argsort(group, kind="stable")
    moment, certain, group = moment[order], certain[order], group[order]
    source, target = _within(group)
    other = moment[source] != moment[target]
    source, target = source[other], target[other]
    relation = np.full(len(source), RELATIONS.index(SAME_GROUP))
    return moment[source], relation, moment[target], certain[source] & certain[target]


def _within(group: Ints) -> tuple[Ints, Ints]:
    """Ordered pairs of rows of equal groups; `group` is ascending."""
    _, start, size = np.unique(group, return_index=True, return_counts=True)
    each = np.repeat(size, size)
    source = np.repeat(np.arange(len(group)), each)
    place = np.arange(len(source)) - np.repeat(np.cumsum(each) - each, each)
    return source, np.repeat(np.repeat(start, size), each) + place
