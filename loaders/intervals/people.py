"""The people of one sequence as arrays, decoded once from the annotation tables.

The rows of all arrays are sorted by frame and track. `Boxes` are 2D boxes in pixels of the stitched panorama. `Located`
are 3D boxes with lidar points, in metres in the frame of the robot: x forward, y left, z up.
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
"""Difficulty in arrays of a label with an unreadable difficulty. It is greater than the code for hard."""
UNWRITTEN = 10
"""Difficulty in arrays of a fact without a label. It is greater than all other codes."""


@dataclass(frozen=True)
class Sighted(Rows):
    """Rows of people in frames."""

    frame: Ints
    track: Ints

    @cached_property
    def keys(self) -> Ints:
        """Return one number per row. The numbers sort like the pairs (frame, track)."""
        return paired(self.frame, self.track)

    def rows(self, frame: Ints, track: Ints) -> Ints:
        """Return the row of each pair (frame, track), or -1 if there is none.

        The rows must be sorted by these pairs.
        """
        return rows_of(self.keys, paired(frame, track))


@dataclass(frozen=True)
class Boxes(Sighted):
    """2D boxes of people with their attributes, one per row."""

    box: Floats
    """Left edge, top edge, width and height in stitched pixels, shape (n, 4)."""
    occlusion: pa.Array
    no_eval: Bools
    listed: Bools
    source: Source
    """Evidence for the masks `clear` and `covered`."""
    clear: Bools
    covered: Bools

    @cached_property
    def angle(self) -> Floats:
        """Return the panorama angle of the centre of each box, in degrees."""
        return center_angle(self.box[:, 0], self.box[:, 2])


@dataclass(frozen=True)
class Facts(Sighted):
    """Facts (track, value) in frames.

    The value of an action is the index of its name in `names`. The value of a group is the id of the cluster.
    """

    value: Ints
    certain: Bools
    """Mask of the facts that are certainly true.

    The label of such a fact is easy or medium, and the person is not covered. A pose is certain only if it is the only
    pose in a complete list.
    """
    difficulty: Ints
    names: tuple[str, ...] = ()
    """Names of the actions, ascending, so that values sort like names."""

    @cached_property
    def is_pose(self) -> Bools:
        """Return for each name whether it is a pose."""
        return np.array([name in POSES for name in self.names], np.bool_)


@dataclass(frozen=True)
class Located(Sighted):
    """3D boxes with lidar points."""

    center: Floats
    """Centres in metres in the frame of the robot, shape (n, 3)."""
    heading: Floats
    """Directions that the people face: radians in [-pi, pi), counter-clockwise from ahead of the robot."""
    distance: Floats
    """Distances from the robot in metres."""


@dataclass(frozen=True)
class Faces(Sighted):
    """People with key points, and whether their faces are visible."""

    visible: Bools
    """Mask of the people with a head or eye that is marked as visible."""


@dataclass(frozen=True)
class People:
    """The people of one sequence."""

    boxes: Boxes
    actions: Facts
    """Actions, one row per (frame, track, action). If an action has several labels, the easiest label counts."""
    pose: Ints
    """Index of the certain pose in the list of each box, or -1. Covered people may have one too."""
    groups: Facts
    """Group labels, at most one row per (frame, track)."""
    located: Located
    faces: Faces
    listed: dict[str, Ints]
    """By layer, the ascending keys of the pairs (frame, track) with a complete list."""


def with_other_words(table: pa.Table, column: str) -> pa.Table:
    """Add a row for each label that may also be true because of another label (`ALSO`).

    Args:
        table: Table of labels.
        column: Column that has the labels.

    Returns:
        The table, followed by the additional rows. Their difficulty is `UNWRITTEN`.
    """
    tables = [table]
    names, written = ranked(table[column])
    for label, also in ((label, also) for label, also in ALSO if label in names):
        rows = table.take(np.flatnonzero(written == names.index(label)))
        added = {column: [also] * len(rows), "difficulty": [UNWRITTEN] * len(rows)}
        tables.append(pa.table({name: added.get(name, rows[name]) for name in rows.column_names}, rows.schema))
    return pa.concat_tables(tables)


def read_people(tables: Mapping[str, pa.Table], rules: LoadRules) -> People:
    """Read the people of one sequence.

    Args:
        tables: Annotation tables by name, with rows sorted by frame and track.
        rules: Thresholds.

    Returns:
        The people.
    """
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
    """Return the actions, and for each box the index of the certain pose in its list (-1 if there is none)."""
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
    posed = certain & pose & (row >= 0)
    pose_of_box[row[posed]] = facts.value[posed]
    return replace(facts, certain=certain & ~np.append(boxes.covered, False)[row]), pose_of_box


def read_groups(table: pa.Table) -> Facts:
    """Read the group labels.

    Args:
        table: Annotation table `groups`.

    Returns:
        The clusters of the people.
    """
    certain = table["difficulty"].fill_null(UNREADABLE).to_numpy() < HARD
    return Facts(*_person_columns(table), whole_numbers(table, "cluster"), certain, np.zeros(len(certain), np.int64))


def read_located(table: pa.Table) -> Located:
    """Read the 3D boxes that have lidar points.

    Args:
        table: Annotation table `boxes_3d`.

    Returns:
        The boxes.
    """
    table = table.filter(pa.array(table["num_points"].fill_null(0).to_numpy() > 0))
    frame, track = _person_columns(table)
    center = np.stack([table[name].to_numpy() for name in ("cx", "cy", "cz")], axis=1)
    ground = np.hypot(center[:, 0], center[:, 1])
    distance = np.where(table["distance"].is_null().to_numpy(), ground, table["distance"].fill_null(0.0).to_numpy())
    return Located(frame, track, center, wrap(math.pi - table["rot_z"].to_numpy()), distance)


def _listed_keys(table: pa.Table, interactions: pa.Table, boxed: Ints) -> dict[str, Ints]:
    """Return the keys of the complete lists of each layer.

    An interaction with a person without a box is in no table. The lists of both people then count as incomplete.
    """
    keys = paired(*_person_columns(table))
    layers = ("interactions", "handles")
    listed = {layer: np.sort(keys[pc.equal(table["layer"], layer).to_numpy()]) for layer in layers}
    frame = whole_numbers(interactions, "frame")
    pair = np.stack([paired(frame, whole_numbers(interactions, name)) for name in ("track", "partner")])
    unseen = (rows_of(boxed, pair.ravel()).reshape(pair.shape) < 0).any(axis=0)
    complete = listed["interactions"]
    listed["interactions"] = complete[rows_of(np.sort(pair[:, unseen], axis=None), complete) < 0]
    return listed


def _read_faces(table: pa.Table) -> Faces:
    values = table["keypoints"].combine_chunks().flatten().to_numpy()
    # Head, right eye and left eye are the first three points of 17 with x, y and visibility each.
    codes = values.reshape(-1, 17, 3)[:, :3, 2]
    return Faces(*_person_columns(table), np.asarray((codes == 2).any(axis=1)))


def wrap(radians: Floats) -> Floats:
    """Reduce angles to one turn.

    Args:
        radians: Angles.

    Returns:
        The angles in [-pi, pi).
    """
    return (radians + math.pi) % (2 * math.pi) - math.pi


def _person_columns(table: pa.Table) -> tuple[Ints, Ints]:
    return whole_numbers(table, "frame"), whole_numbers(table, "track")


def track_spans(tables: Mapping[str, pa.Table]) -> tuple[Ints, Ints, Ints]:
    """Find the tracks with a 2D or 3D box.

    Args:
        tables: Annotation tables by name.

    Returns:
        The tracks, ascending, and the first and the last frame of each track.
    """
    boxes = pa.concat_tables(tables[layer].select(["track", "frame"]) for layer in ("boxes_2d", "boxes_3d"))
    spans = boxes.group_by("track").aggregate([("frame", "min"), ("frame", "max")]).sort_by("track")
    return whole_numbers(spans, "track"), whole_numbers(spans, "frame_min"), whole_numbers(spans, "frame_max")
