"""The interval table `sightings`: everything known of a person in one frame, one row per 2D box.

Sectors and distance words with their margins: which word is true, and which other it could be near an edge.

All margins are inclusive.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.loaders.intervals.people import Boxes, Facts, People, rows_of
from jrdb_avr.loaders.intervals.timeline import Timeline
from jrdb_avr.loaders.labelfiles.columns import ascending, begins, distinct_of, nullable, paired, texts
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS, ROBOT_SECTORS, PersonSector
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.rules import KEYFRAME_STEP, SLACK, LoadRules


def robot_sector(angle_deg: Floats, rules: LoadRules) -> Ints:
    """Of panorama angles: index into ROBOT_SECTORS of the sector that is true, -1 where none is."""
    off = angle_error(angle_deg[:, None], np.array(list(ROBOT_SECTORS.values())))
    return np.where(off.min(axis=1) <= rules.sector_true_deg + SLACK, off.argmin(axis=1), -1)


def in_person_sector(bearing_deg: Floats, sector: PersonSector) -> tuple[Bools, Bools]:
    """Of bearings off a person's heading, [-180, 180], left positive: whether the sector is true, and may be."""
    size = np.abs(bearing_deg)
    here = np.full(len(size), True)
    if sector.side != "either":
        towards = bearing_deg if sector.side == "left" else -bearing_deg
        # Straight ahead and straight behind lie on both sides.
        here = (towards >= -SLACK) | (size >= 180.0 - SLACK)
    within = [
        here & (size >= low - SLACK) & (size <= high + SLACK)
        for low, high in ((sector.low, sector.high), (sector.least, sector.most))
    ]
    return within[0], within[1]


def distance_word(metres: Floats, rules: LoadRules) -> tuple[Ints, Ints]:
    """Of distances: index into DISTANCE_WORDS, and of the other possible word near a bound (else -1)."""
    bounds = np.array(DISTANCE_BOUNDS_M)
    word = np.searchsorted(bounds, metres, "left")
    away = np.abs(metres[:, None] - bounds)
    near = away <= rules.distance_margin * bounds + SLACK
    bound = near.argmax(axis=1)
    other = np.where(word == bound, bound + 1, bound)
    return word, np.where(near.any(axis=1), other, -1)


N = TypeVar("N", bound=np.generic)


def sightings_table(line: Timeline, people: People, rules: LoadRules, views_listed: tuple[bool, bool]) -> pa.Table:
    """Return all sightings of a sequence, by frame and track. `views_listed` is from `beside_table`."""
    boxes, located = people.boxes, people.located
    member, place, face = (rows_of(other.keys, boxes.keys) for other in (people.groups, located, people.faces))
    judge = group_sizes if rules.visibility == "any" else group_sizes_in_view
    least, most, known = judge(line, boxes, people.groups, member)
    distance = _take(located.distance, place)
    words = (np.where(place >= 0, word, -1) for word in distance_word(distance, rules))
    metric = {
        "distance": distance,
        "heading": _take(located.heading, place),
        **{name: _take(located.center[:, i], place) for i, name in enumerate(("cx", "cy", "cz"))},
    }
    columns = {
        **{name: boxes.box[:, i] for i, name in enumerate("xywh")},
        **{
            name: getattr(boxes, name)
            for name in ("frame", "track", "angle", "occlusion", "no_eval", "clear", "covered", "listed")
        },
        "face_visible": nullable(_take(people.faces.visible, face), face < 0, pa.bool_()),
        **{f"{layer}_listed": rows_of(keys, boxes.keys) >= 0 for layer, keys in people.listed.items()},
        "pose": texts(people.actions.names, certain_pose(boxes, people.actions)),
        "posed": people.posed,
        "cluster": nullable(_take(people.groups.value, member), member < 0, pa.int64()),
        "group_size": nullable(least, ~known | (least < most), pa.int32()),
        "group_size_min": nullable(least, ~known, pa.int32()),
        "group_size_max": nullable(most, ~known, pa.int32()),
        "sector": texts(tuple(ROBOT_SECTORS), robot_sector(boxes.angle, rules)),
        "located": place >= 0,
        **{
            name: texts(DISTANCE_WORDS, w)
            for name, w in zip(("distance_word", "distance_word_other"), words, strict=True)
        },
        **{name: nullable(values, place < 0, pa.float64()) for name, values in metric.items()},
        "robot_view_listed": np.full(len(place), views_listed[0]),
        "person_view_listed": (place >= 0) & views_listed[1],
    }
    return line.table("sightings", columns)


def certain_pose(boxes: Boxes, actions: Facts) -> Ints:
    """Per box: the action code of its one certain pose, -1 where the pose is unknown."""
    poses = actions.at(actions.certain & np.append(actions.is_pose, False)[actions.value])
    row = boxes.rows(poses.frame, poses.track)
    result = np.full(len(boxes.frame), -1, np.int64)
    result[row[row >= 0]] = poses.value[row >= 0]
    return result


def group_sizes_in_view(line: Timeline, boxes: Boxes, groups: Facts, cluster_row: Ints) -> tuple[Ints, Ints, Bools]:
    """Return the minimum and the maximum of the size of each person's group, and whether they are known.

    The person counts one, and so does every other member in clear view. Uncertain members add to the maximum only.
    A person who is not covered is an uncertain member of every group if the own membership is hard or missing.

    Args:
        line: Frames of the sequence.
        boxes: Boxes of the people.
        groups: Group labels.
        cluster_row: Row of each box's person in `groups`, -1 if there is no label.

    Returns:
        One element per box. The size is unknown if the person is covered, if the own membership is hard or missing, or
        if a record of the frame could not be read.
    """
    member = (cluster_row >= 0) & _take(groups.certain, cluster_row) & ~boxes.covered
    cluster = np.where(member, _take(groups.value, cluster_row), -1)
    order = ascending(boxes.frame, cluster)
    group = np.empty_like(order)
    group[order] = np.cumsum(begins(boxes.frame[order], cluster[order])) - 1
    frame = np.cumsum(begins(boxes.frame)) - 1
    clear, members, doubts = (
        np.bincount(key, weights=people).astype(np.int64)[key]
        for key, people in ((group, member & boxes.clear), (group, member), (frame, ~member & ~boxes.covered))
    )
    return 1 + clear - boxes.clear, members + doubts, member & np.isin(boxes.frame, line.frames_of("2d"))


def group_sizes(line: Timeline, boxes: Boxes, groups: Facts, cluster_row: Ints) -> tuple[Ints, Ints, Bools]:
    """Per box: people of the frame in the same cluster, oneself included, twice, and whether that is known. Applies if
    the rules do not judge who is in clear view.

    It is known where every person of the frame could be read and has a cluster row, no row of the cluster is hard, and
    nobody of the cluster is out of the picture for a moment. Somebody without a row might belong to any group, and so
    might whoever is in a frame within a second that could not be read.
    """
    has_row = cluster_row >= 0
    cluster, certain = _take(groups.value, cluster_row), _take(groups.certain, cluster_row)
    # A person without a row takes part in no cluster; -1 - row keeps it apart from its neighbours.
    order = ascending(boxes.frame, ~has_row, cluster)
    frame, cluster, has_row, certain = boxes.frame[order], cluster[order], has_row[order], certain[order]
    group = np.cumsum(begins(frame, cluster) | ~has_row) - 1
    members = np.bincount(group)
    hard = np.bincount(group, weights=~certain) > 0
    complete = np.isin(frame, line.frames_of("2d")) & ~np.isin(frame, frame[~has_row])
    sizes, known = np.empty(len(frame), np.int64), np.empty(len(frame), np.bool_)
    sizes[order] = members[group]
    away, doubtful = _away(line, boxes, groups, boxes.frame[cluster_row < 0], boxes.track[cluster_row < 0])
    complete &= ~np.isin(frame, doubtful)
    known[order] = complete & has_row & ~hard[group] & ~np.isin(paired(frame, cluster), away)
    return sizes, sizes, known


def _away(line: Timeline, boxes: Boxes, groups: Facts, bare_frame: Ints, bare_track: Ints) -> tuple[Ints, Ints]:
    """Groups with a member out of the picture who is seen within a second, as keys of (frame, cluster); and frames at
    which anybody might be such a member, of those within a second who could not be read or have no row (`bare`)."""
    grid = line.grid("2d")
    if grid is None or not len(groups.frame):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    row, frame = _gone(line, boxes, groups.frame, groups.track)
    _, doubtful = _gone(line, boxes, bare_frame, bare_track)
    near = np.arange(grid.first - KEYFRAME_STEP, grid.last + KEYFRAME_STEP + 1, grid.step)
    # Beyond the ends of the 2D layer only where boxes or groups show that labelling goes on.
    labelled = np.concatenate([boxes.frame, *(line.frames_of(layer) for layer in ("2d", "groups"))])
    near = near[(near >= labelled.min()) & (near <= labelled.max())]
    unread = np.setdiff1d(near, line.frames_of("2d"))
    around = unread[:, None] + np.arange(-KEYFRAME_STEP, KEYFRAME_STEP + 1)
    keys = distinct_of(np.sort(paired(frame, groups.value[row])))
    return keys, np.unique(np.append(doubtful, around.ravel()))


def _gone(line: Timeline, boxes: Boxes, frame: Ints, track: Ints) -> tuple[Ints, Ints]:
    """Of people seen at frames: their rows, and annotated frames within a second without a box of theirs."""
    annotated = line.frames_of("2d")
    # Most people are there all the time: they are left out first.
    around = np.maximum(frame - KEYFRAME_STEP, 0), frame + KEYFRAME_STEP
    whole = np.isin(boxes.frame, annotated)
    by_person = np.sort(paired(boxes.track[whole], boxes.frame[whole]))
    seen, frames = (
        np.searchsorted(known, high, "right") - np.searchsorted(known, low, "left")
        for known, low, high in ((by_person, *(paired(track, one) for one in around)), (annotated, *around))
    )
    rows = np.flatnonzero(seen < frames)
    found = [np.empty((2, 0), np.int64)]
    for away in range(-KEYFRAME_STEP, KEYFRAME_STEP + 1):
        there = frame[rows] + away
        gone = np.isin(there, annotated) & (boxes.rows(there, track[rows]) < 0)
        found.append(np.stack([rows[gone], there[gone]]))
    row, there = np.hstack(found)
    return row, there


def _take(values: npt.NDArray[N], row: Ints) -> npt.NDArray[N]:
    """Values at rows; zero where the row is -1."""
    if not len(values):
        return np.zeros(len(row), values.dtype)
    return np.where(row >= 0, values[row], np.zeros(1, values.dtype))
