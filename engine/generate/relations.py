"""Relations between people at keyframes, as facts of three values.

A *fact* joins two moments of one keyframe: certain, or possible (a hard label, a closed gap, an edge of a sector).
Where a person's list was not read, a 3D box has no lidar points, or `load` left a kind out of the sequence, every
relation of that kind with anybody is possible.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene, coded, flags
from jrdb_avr.schema.arrays import Bools
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.relations import LAYER_OF_KIND, QUESTION_RELATIONS, SAME_GROUP
from jrdb_avr.schema.relations import RELATIONS as ROWS
from jrdb_avr.schema.wording.text import poses_of

SOCIAL, GROUP, ROBOT_VIEW, PERSON_VIEW = range(4)
"""Layers with relations: where a layer is unknown of a person, all its relations are."""

RELATION_LAYERS: Final = ("interactions", "groups", "2d", "3d")
"""The layer that tells of each kind of relation."""

RELATIONS: Final = QUESTION_RELATIONS
"""Relations that a question may name; coded columns are indices into it. Of windows, which hold of several people,
there are no facts here and no steps: see `fork_join`."""

KIND: Final = np.array([RELATION_LAYERS.index(LAYER_OF_KIND[ROWS[label].kind]) for label in RELATIONS], np.int64)

RELATION_BITS: Final = np.int64(1) << np.arange(len(RELATIONS))
"""The bit of each relation, in sums of them."""

STATED_POSES: Final = np.array([[pose in poses_of(relation) for pose in POSES] for relation in RELATIONS])
"""(relations, poses): the poses that a relation's words name."""


@dataclass(frozen=True)
class Facts:
    """Every pair of moments with a relation that is or could be, once per relation.

    known (kinds, moments): whether it is known of a moment who its partners in a kind are. Of two people of whom one is
    not known, every relation of the kind that has no fact is unknown.
    """

    source: Ints
    relation: Ints
    target: Ints
    certain: Bools
    known: Bools

    @property
    def unread(self) -> Bools:
        """Per fact, whether without it the relation would be unknown: of one of the two the kind is not known."""
        kind = KIND[self.relation]
        return np.asarray(~(self.known[kind, self.source] & self.known[kind, self.target]))


def find_facts(scene: Scene) -> Facts:
    """All relations at the keyframes of a scene, between people with a box there."""
    parts = [_labelled_pairs(scene, scene.interactions), _labelled_pairs(scene, scene.beside), _groups(scene)]
    source, relation, target, certain = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    # A pair may have a row by each of two spans: what is certain by one of them is certain.
    key = (source * len(RELATIONS) + relation) * scene.moment_count + target
    order = np.lexsort((~certain, key))
    first = order[np.unique(key[order], return_index=True)[1]]
    return Facts(source[first], relation[first], target[first], certain[first], _known(scene))


def unknown_others(scene: Scene, known: Bools) -> Ints:
    """(kinds, moments): with how many others every relation of a kind is possible for want of knowledge."""
    there = np.zeros(scene.moment_count, dtype=bool)
    there[scene.seen_moments] = True
    shape = len(scene.tracks), len(scene.keyframes)
    silent = (there & ~known).reshape(len(known), *shape).sum(axis=1)
    people = there.reshape(shape).sum(axis=0)
    others = np.where(known.reshape(len(known), *shape), silent[:, None], people - 1)
    return np.asarray(others.reshape(known.shape), dtype=np.int64)


def _known(scene: Scene) -> Bools:
    known = np.ones((len(RELATION_LAYERS), scene.moment_count), bool)
    there, rows = scene.seen_moments, scene.moment_rows[scene.seen_moments]
    known[SOCIAL, there] = scene.flag("interactions_listed")[rows]
    known[ROBOT_VIEW, there] = scene.flag("robot_view_listed")[rows]
    known[PERSON_VIEW, there] = scene.flag("person_view_listed")[rows]
    known[GROUP] = False
    known[GROUP, scene.covered(scene.memberships, "track")[1]] = True
    return known


# -- facts by kind ----------------------------------------------------------------------------------------------

_Part = tuple[Ints, Ints, Ints, Bools]


def _labelled_pairs(scene: Scene, table: pa.Table) -> _Part:
    """Facts of a table of labelled spans between a source and a target track; unknown labels are left out."""
    row, source, target = scene.covered(table, "source", "target")
    relation = coded(table["label"], RELATIONS)[row]
    there = (scene.moment_rows[source] != NOBODY) & (scene.moment_rows[target] != NOBODY) & (relation != NOBODY)
    return source[there], relation[there], target[there], flags(table, "certain")[row][there]


def _groups(scene: Scene) -> _Part:
    """Pairs of members of one cluster: certain where both memberships are."""
    row, moment = scene.covered(scene.memberships, "track")
    there = scene.moment_rows[moment] != NOBODY
    row, moment = row[there], moment[there]
    cluster = np.unique(scene.memberships["cluster"].to_numpy(), return_inverse=True)[1][row]
    certain = flags(scene.memberships, "certain")[row]
    group = moment % max(len(scene.keyframes), 1) * (int(cluster.max(initial=0)) + 1) + cluster
    order = np.argsort(group, kind="stable")
    source, target = (order[rows] for rows in _within(group[order]))
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
