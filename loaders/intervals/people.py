"""The people of one sequence as arrays: the annotation tables decoded once, for every derived table to read.

All arrays are sorted by (frame, track). `Boxes` are 2D boxes in stitched pixels; `Located` are 3D boxes with lidar
points, in metres in the robot frame (x forward, y left, z up).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.loaders.labelfiles.columns import begins, person_keys, ranked, whole_numbers
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.labels import CLEAR_OCCLUSIONS, POSES
from jrdb_avr.schema.panorama import HEIGHT, center_angle
from jrdb_avr.schema.rules import LoadRules

HARD = 3
UNREADABLE = 9
"""Stands for a missing difficulty in arrays: harder than hard."""


@dataclass(frozen=True)
class Boxes:
    """2D boxes."""

    frame: Ints
    track: Ints
    box: Floats
    """(n, 4): x, y, w, h."""
    occlusion: pa.Array
    no_eval: Bools
    listed: Bools
    has_attributes: bool
    """Whether any record of the sequence carries attributes."""
    rules: LoadRules

    @cached_property
    def keys(self) -> Ints:
        """One ascending number per (frame, track)."""
        return person_keys(self.frame, self.track)

    @cached_property
    def angle(self) -> Floats:
        """Panorama angle of the box centres, degrees."""
        return center_angle(self.box[:, 0], self.box[:, 2])

    @cached_property
    def clear(self) -> Bools:
        """The clear view of the rules, per box."""
        rules = self.rules
        _, y, w, h = self.box.T
        sized = (w >= rules.clear_min_width) & (w <= rules.clear_max_width) & (h >= rules.clear_min_height)
        result = sized & (y >= 0) & (y + h <= HEIGHT) & ~self.no_eval
        if self.has_attributes:
            result &= pc.is_in(self.occlusion, pa.array(sorted(CLEAR_OCCLUSIONS))).to_numpy(zero_copy_only=False)
        return np.asarray(result)

    def rows(self, frame: Ints, track: Ints) -> Ints:
        """Row of each (frame, track), -1 where there is no box."""
        return rows_of(self.keys, person_keys(frame, track))


@dataclass(frozen=True)
class Labels:
    """Actions, one row per (frame, track, action): spellings of one action are merged, the easier code counts."""

    names: list[str]
    """Ascending, so that codes sort as names do."""
    frame: Ints
    track: Ints
    action: Ints
    difficulty: Ints
    certain: Bools
    """True of the person: easy or middle, and of poses the only one in the list."""

    @cached_property
    def is_pose(self) -> Bools:
        """Per name."""
        return np.array([name in POSES for name in self.names], np.bool_)


@dataclass(frozen=True)
class Groups:
    """Cluster rows, at most one per (frame, track)."""

    frame: Ints
    track: Ints
    cluster: Ints
    certain: Bools


@dataclass(frozen=True)
class Located:
    """3D boxes with lidar points."""

    frame: Ints
    track: Ints
    center: Floats
    """(n, 3)."""
    heading: Floats
    """Radians in (-pi, pi], counter-clockwise from straight ahead of the robot."""
    distance: Floats
    """Metres from the robot."""

    @cached_property
    def keys(self) -> Ints:
        return person_keys(self.frame, self.track)


def rows_of(keys: Ints, wanted: Ints) -> Ints:
    """Position of each wanted key in ascending `keys`, -1 where missing."""
    if not len(keys):
        return np.full(len(wanted), -1, np.int64)
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[place] == wanted, place, -1)


def read_boxes(table: pa.Table, rules: LoadRules) -> Boxes:
    """From the annotation table `boxes_2d`, whose rows are sorted by (frame, track)."""
    box = np.stack([table[name].to_numpy() for name in "xywh"], axis=1)
    attributed = table["has_attributes"].to_numpy()
    return Boxes(
        *_person_columns(table),
        box,
        table["occlusion"].combine_chunks(),
        table["no_eval"].fill_null(False).to_numpy(),
        table["has_actions"].to_numpy(),
        bool(attributed.any()),
        rules,
    )


def read_labels(table: pa.Table) -> Labels:
    """From the annotation table `actions`."""
    names, action = ranked(table["action"])
    frame, track = _person_columns(table)
    difficulty = table["difficulty"].fill_null(UNREADABLE).to_numpy().astype(np.int64)
    order = np.lexsort((difficulty, action, track, frame))
    frame, track, action, difficulty = frame[order], track[order], action[order], difficulty[order]
    keys = person_keys(frame, track)
    first = begins(keys, action)
    frame, track, action, difficulty = frame[first], track[first], action[first], difficulty[first]
    pose = np.array([name in POSES for name in names], np.bool_)[action] if len(action) else np.empty(0, np.bool_)
    _, person = np.unique(keys[first], return_inverse=True)
    poses = np.bincount(person, weights=pose)[person] if len(person) else np.empty(0)
    certain = (difficulty < HARD) & (~pose | (poses == 1))
    return Labels(names, frame, track, action, difficulty, certain)


def read_groups(table: pa.Table) -> Groups:
    """From the annotation table `groups`."""
    frame, track = _person_columns(table)
    certain = table["difficulty"].fill_null(UNREADABLE).to_numpy() < HARD
    return Groups(frame, track, table["cluster"].to_numpy(), certain)


def read_located(table: pa.Table) -> Located:
    """From the annotation table `boxes_3d`: only the boxes with lidar points."""
    table = table.filter(pa.array(table["num_points"].fill_null(0).to_numpy() > 0))
    frame, track = _person_columns(table)
    center = np.stack([table[name].to_numpy() for name in ("cx", "cy", "cz")], axis=1)
    ground = np.hypot(center[:, 0], center[:, 1])
    distance = np.where(table["distance"].is_null().to_numpy(), ground, table["distance"].fill_null(0.0).to_numpy())
    return Located(frame, track, center, wrap(math.pi - table["rot_z"].to_numpy()), distance)


def listed_keys(table: pa.Table) -> dict[str, Ints]:
    """From the annotation table `listed`: per layer, ascending keys of (frame, track) whose list was read."""
    keys = person_keys(*_person_columns(table))
    layers = ("interactions", "handles")
    return {layer: np.sort(keys[pc.equal(table["layer"], layer).to_numpy()]) for layer in layers}


@dataclass(frozen=True)
class Faces:
    """People with a pose."""

    keys: Ints
    """One ascending number per (frame, track)."""
    visible: Bools
    """Whether the head or an eye is marked visible."""


def read_faces(table: pa.Table) -> Faces:
    """From the annotation table `poses`, whose rows are sorted by (frame, track)."""
    values = table["keypoints"].combine_chunks().flatten().to_numpy()
    # Head, right eye and left eye are the first three points of 17 with x, y and visibility each.
    codes = values.reshape(-1, 17, 3)[:, :3, 2]
    return Faces(person_keys(*_person_columns(table)), np.asarray((codes == 2).any(axis=1)))


def wrap(radians: Floats) -> Floats:
    """Angles in [-pi, pi)."""
    return (radians + math.pi) % (2 * math.pi) - math.pi


def _person_columns(table: pa.Table) -> tuple[Ints, Ints]:
    return whole_numbers(table, "frame"), whole_numbers(table, "track")


def track_spans(tables: Mapping[str, pa.Table]) -> tuple[Ints, Ints, Ints]:
    """Tracks of any box, 2D or 3D, ascending, with the first and last frame of each."""
    columns = [_person_columns(tables[layer]) for layer in ("boxes_2d", "boxes_3d")]
    frame = np.concatenate([pair[0] for pair in columns])
    track = np.concatenate([pair[1] for pair in columns])
    order = np.lexsort((frame, track))
    frame, track = frame[order], track[order]
    tracks, start = np.unique(track, return_index=True)
    last = np.append(start[1:], len(track)) - 1
    return tracks, frame[start], frame[last] if len(track) else frame
