"""The people of one sequence as arrays: the annotation tables decoded once, for every derived table to read.

All arrays are sorted by (frame, track). `Boxes` are 2D boxes in stitched pixels; `Located` are 3D boxes with lidar
points, in metres in the robot frame (x forward, y left, z up).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.loaders.intervals.visibility import Source, classify_boxes
from jrdb_avr.loaders.labelfiles.columns import Rows, ascending, begins, paired, ranked, rows_of, whole_numbers
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.labels import ALSO, POSES
from jrdb_avr.schema.panorama import center_angle
from jrdb_avr.schema.rules import LoadRules

HARD = 3
UNREADABLE = 9
"""Stands for a missing difficulty in arrays: harder than hard."""
UNWRITTEN = 10
"""Stands for the difficulty of a fact without a label of its own: harder than unreadable."""


@dataclass(frozen=True)
class Sighted(Rows):
    """Rows of people in frames."""

    frame: Ints
    track: Ints

    @cached_property
    def keys(self) -> Ints:
        """One number per (frame, track), which sorts as they do."""
        return paired(self.frame, self.track)

    def rows(self, frame: Ints, track: Ints) -> Ints:
        """Row of each (frame, track), -1 where there is none; for rows sorted by (frame, track)."""
        return rows_of(self.keys, paired(frame, track))


@dataclass(frozen=True)
class Boxes(Sighted):
    """2D boxes of people, one a row, with their attributes."""

    box: Floats
    """(n, 4): x, y, w, h."""
    occlusion: pa.Array
    no_eval: Bools
    listed: Bools
    source: Source
    """What the classes below are judged by."""
    clear: Bools
    covered: Bools

    @cached_property
    def angle(self) -> Floats:
        """Panorama angle of the box centres, degrees."""
        return center_angle(self.box[:, 0], self.box[:, 2])


@dataclass(frozen=True)
class Facts(Sighted):
    """Facts (track, value) in frames: of actions the value is the action's place among the names, of groups the
    cluster."""

    value: Ints
    certain: Bools
    """True of the person: easy or middle, not covered, and of poses the only one in a list that tells all."""
    difficulty: Ints
    names: tuple[str, ...] = ()
    """Ascending, so that values sort as names do."""

    @cached_property
    def is_pose(self) -> Bools:
        """Whether each name is one of a pose."""
        return np.array([name in POSES for name in self.names], np.bool_)


@dataclass(frozen=True)
class Located(Sighted):
    """3D boxes with lidar points."""

    center: Floats
    """(n, 3)."""
    heading: Floats
    """Radians in [-pi, pi), counter-clockwise from straight ahead of the robot."""
    distance: Floats
    """Metres from the robot."""


@dataclass(frozen=True)
class Faces(Sighted):
    """People with body keypoints, and whether their face is visible."""

    visible: Bools
    """Whether the head or an eye is marked visible."""


@dataclass(frozen=True)
class People:
    """The people of one sequence, from its annotation tables."""

    boxes: Boxes
    actions: Facts
    """One row per (frame, track, action): spellings of one action are merged, the easier code counts."""
    pose: Ints
    """Per box, the code of the one certain pose in the person's list, or -1. Covered people have one too."""
    groups: Facts
    """At most one row per (frame, track)."""
    located: Located
    faces: Faces
    listed: dict[str, Ints]
    """Per layer, ascending keys of (frame, track) whose list was read."""


def with_other_words(table: pa.Table, column: str) -> pa.Table:
    """A table of labels with doubtful rows added: labels whose words may also be said of the same person."""
    tables = [table]
    names, written = ranked(table[column])
    for label, other in ((label, other) for label, other in ALSO if label in names):
        rows = table.take(np.flatnonzero(written == names.index(label)))
        added = {column: [other] * len(rows), "difficulty": [UNWRITTEN] * len(rows)}
        tables.append(pa.table({name: added.get(name, rows[name]) for name in rows.column_names}, rows.schema))
    return pa.concat_tables(tables)


def read_people(tables: Mapping[str, pa.Table], rules: LoadRules) -> People:
    """Read the annotation tables, whose rows are sorted by (frame, track)."""
    boxes = _read_boxes(tables["boxes_2d"], tables["groups"], rules)
    return People(
        boxes,
        *_read_actions(tables["actions"], boxes),
        read_groups(tables["groups"]),
        read_located(tables["boxes_3d"]),
        _read_faces(tables["poses"]),
        _listed_keys(tables["listed"], tables["interactions"], boxes.keys),
    )


def _read_boxes(table: pa.Table, groups: pa.Table, rules: LoadRules) -> Boxes:
    source, clear, covered = classify_boxes(table, groups, rules)
    return Boxes(
        *_person_columns(table),
        np.stack([table[name].to_numpy() for name in "xywh"], axis=1),
        table["occlusion"].combine_chunks(),
        table["no_eval"].fill_null(False).to_numpy(),
        table["has_actions"].to_numpy(),
        source,
        clear,
        covered,
    )


def _read_actions(table: pa.Table, boxes: Boxes) -> tuple[Facts, Ints]:
    names, action = ranked(table["action"])
    difficulty = table["difficulty"].fill_null(UNREADABLE).to_numpy().astype(np.int64)
    facts = Facts(*_person_columns(table), action, difficulty < HARD, difficulty, tuple(names))
    facts = facts.at(ascending(facts.frame, facts.track, facts.value, facts.difficulty))
    facts = facts.at(begins(facts.keys, facts.value))
    pose = np.append(facts.is_pose, False)[facts.value]
    person = np.cumsum(begins(facts.keys)) - 1
    poses = np.bincount(person, weights=pose & (facts.difficulty < UNWRITTEN))[person]
    row = boxes.rows(facts.frame, facts.track)
    whole = np.append(boxes.listed, False)[row]
    certain = facts.certain & (~pose | ((poses == 1) & whole))
    pose_of_box = np.full(len(boxes.frame), -1, np.int64)
    told = certain & pose & (row >= 0)
    pose_of_box[row[told]] = facts.value[told]
    return replace(facts, certain=certain & ~np.append(boxes.covered, False)[row]), pose_of_box


def read_groups(table: pa.Table) -> Facts:
    """Clusters, from the annotation table `groups`."""
    certain = table["difficulty"].fill_null(UNREADABLE).to_numpy() < HARD
    return Facts(*_person_columns(table), whole_numbers(table, "cluster"), certain, np.zeros(len(certain), np.int64))


def read_located(table: pa.Table) -> Located:
    """From the annotation table `boxes_3d`: only the boxes with lidar points."""
    table = table.filter(pa.array(table["num_points"].fill_null(0).to_numpy() > 0))
    frame, track = _person_columns(table)
    center = np.stack([table[name].to_numpy() for name in ("cx", "cy", "cz")], axis=1)
    ground = np.hypot(center[:, 0], center[:, 1])
    distance = np.where(table["distance"].is_null().to_numpy(), ground, table["distance"].fill_null(0.0).to_numpy())
    return Located(frame, track, center, wrap(math.pi - table["rot_z"].to_numpy()), distance)


def _listed_keys(table: pa.Table, interactions: pa.Table, boxed: Ints) -> dict[str, Ints]:
    """Interactions with somebody without a box are facts that no table holds, so that no list tells all of either."""
    keys = paired(*_person_columns(table))
    layers = ("interactions", "handles")
    listed = {layer: np.sort(keys[pc.equal(table["layer"], layer).to_numpy()]) for layer in layers}
    frame = whole_numbers(interactions, "frame")
    pair = np.stack([paired(frame, whole_numbers(interactions, name)) for name in ("track", "partner")])
    unseen = (rows_of(boxed, pair.ravel()).reshape(pair.shape) < 0).any(axis=0)
    known = listed["interactions"]
    listed["interactions"] = known[rows_of(np.sort(pair[:, unseen], axis=None), known) < 0]
    return listed


def _read_faces(table: pa.Table) -> Faces:
    values = table["keypoints"].combine_chunks().flatten().to_numpy()
    # Head, right eye and left eye are the first three points of 17 with x, y and visibility each.
    codes = values.reshape(-1, 17, 3)[:, :3, 2]
    return Faces(*_person_columns(table), np.asarray((codes == 2).any(axis=1)))


def wrap(radians: Floats) -> Floats:
    """Angles in [-pi, pi)."""
    return (radians + math.pi) % (2 * math.pi) - math.pi


def _person_columns(table: pa.Table) -> tuple[Ints, Ints]:
    return whole_numbers(table, "frame"), whole_numbers(table, "track")


def track_spans(tables: Mapping[str, pa.Table]) -> tuple[Ints, Ints, Ints]:
    """Tracks of any box, 2D or 3D, ascending, with the first and last frame of each."""
    boxes = pa.concat_tables(tables[layer].select(["track", "frame"]) for layer in ("boxes_2d", "boxes_3d"))
    spans = boxes.group_by("track").aggregate([("frame", "min"), ("frame", "max")]).sort_by("track")
    return whole_numbers(spans, "track"), whole_numbers(spans, "frame_min"), whole_numbers(spans, "frame_max")
