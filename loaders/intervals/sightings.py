"""Interval table `sightings`, with one row per 2D box: the facts about a person in one frame.

Sectors and distance words have margins. Near the edge of a sector, or near a bound between two distance words, a fact
is unknown. All margins include their bounds.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.loaders.intervals.people import Boxes, Facts, People
from jrdb_avr.loaders.intervals.timeline import Grid, Timeline, step_of
from jrdb_avr.loaders.labelfiles.columns import begins, group_rows, nullable, paired, rank_values, rows_of, texts
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS, ROBOT_SECTORS, PersonSector
from jrdb_avr.schema.panorama import angle_error
from jrdb_avr.schema.rules import KEYFRAME_STEP, SLACK, LoadRules


def robot_sector(angle_deg: Floats, rules: LoadRules) -> Ints:
    """Find the sector of the robot for each angle.

    Args:
        angle_deg: Panorama angles in degrees.
        rules: Thresholds.

    Returns:
        Index in `ROBOT_SECTORS` of the true sector, or -1 if no sector is true.
    """
    off = angle_error(angle_deg[:, None], np.array(list(ROBOT_SECTORS.values())))
    return np.where(off.min(axis=1) <= rules.sector_true_deg + SLACK, off.argmin(axis=1), -1)


def in_person_sector(bearing_deg: Floats, sector: PersonSector) -> tuple[Bools, Bools]:
    """Check whether directions are in a sector of a person.

    Args:
        bearing_deg: Directions in degrees in [-180, 180], counter-clockwise from the direction that the person faces.
        sector: Sector.

    Returns:
        Two masks of directions: the sector is true, and the sector is true or unknown.
    """
    size = np.abs(bearing_deg)
    on_side = np.full(len(size), True)
    if sector.side != "either":
        towards = bearing_deg if sector.side == "left" else -bearing_deg
        # The directions straight ahead and straight behind are on both sides.
        on_side = (towards >= -SLACK) | (size >= 180.0 - SLACK)
    within = [
        on_side & (size >= low - SLACK) & (size <= high + SLACK)
        for low, high in ((sector.low, sector.high), (sector.least, sector.most))
    ]
    return within[0], within[1]


def distance_word(metres: Floats, rules: LoadRules) -> tuple[Ints, Ints]:
    """Find the word for each distance.

    Args:
        metres: Distances in metres.
        rules: Thresholds.

    Returns:
        Index in `DISTANCE_WORDS` of the word, and the index of the second possible word near a bound, or -1.
    """
    bounds = np.array(DISTANCE_BOUNDS_M)
    word = np.searchsorted(bounds, metres, "left")
    near = np.abs(metres[:, None] - bounds) <= rules.distance_margin * bounds + SLACK
    bound = near.argmax(axis=1)
    second = np.where(word == bound, bound + 1, bound)
    return word, np.where(near.any(axis=1), second, -1)


N = TypeVar("N", bound=np.generic)


def sightings_table(line: Timeline, people: People, rules: LoadRules, views_listed: tuple[bool, bool]) -> pa.Table:
    """Derive all sightings of a sequence, sorted by frame and track.

    Args:
        line: Frames of the sequence.
        people: People of the sequence.
        rules: Thresholds.
        views_listed: Second result of `beside_table`.

    Returns:
        The table.
    """
    boxes, located = people.boxes, people.located
    member, solid, face = (rows_of(part.keys, boxes.keys) for part in (people.groups, located, people.faces))
    least, most, sized = group_sizes(line, boxes, people.groups, member, rules)
    codes = (np.where(solid >= 0, code, -1) for code in distance_word(_take(located.distance, solid), rules))
    terms = zip(("distance_word", "distance_word_other"), (texts(DISTANCE_WORDS, code) for code in codes), strict=True)
    metrics = {name: located.center[:, i] for i, name in enumerate(("cx", "cy", "cz"))}
    metrics |= {"distance": located.distance, "heading": located.heading}
    columns = {
        **{name: boxes.box[:, i] for i, name in enumerate("xywh")},
        **{
            name: getattr(boxes, name)
            for name in ("frame", "track", "angle", "occlusion", "no_eval", "clear", "covered", "listed")
        },
        "face_visible": nullable(_take(people.faces.visible, face), face < 0, pa.bool_()),
        **{f"{layer}_listed": rows_of(keys, boxes.keys) >= 0 for layer, keys in people.listed.items()},
        "pose": texts(people.actions.names, np.where(boxes.covered, -1, people.pose)),
        "posed": people.pose >= 0,
        "cluster": nullable(_take(people.groups.value, member), member < 0, pa.int64()),
        "group_size": nullable(least, ~sized | (least < most), pa.int32()),
        "group_size_min": nullable(least, ~sized, pa.int32()),
        "group_size_max": nullable(most, ~sized, pa.int32()),
        "sector": texts(tuple(ROBOT_SECTORS), robot_sector(boxes.angle, rules)),
        "located": solid >= 0,
        **dict(terms),
        **{name: nullable(_take(values, solid), solid < 0, pa.float64()) for name, values in metrics.items()},
        "robot_view_listed": np.full(len(solid), views_listed[0]),
        "person_view_listed": (solid >= 0) & views_listed[1],
    }
    return line.table("sightings", columns)


def group_sizes(
    line: Timeline, boxes: Boxes, groups: Facts, cluster_row: Ints, rules: LoadRules
) -> tuple[Ints, Ints, Bools]:
    """Return the minimum and the maximum size of each person's group, and whether they are known.

    The person and every other member in clear view count for the minimum. The maximum also counts uncertain members. A
    person who is not covered is an uncertain member of every group if the person's group label is hard or missing.

    If the rules do not judge views, every member with a box counts. A size is then known only if all people of the
    frame have a group label, if no label of the group is hard, and if no member may be absent for a moment.

    Args:
        line: Frames of the sequence.
        boxes: Boxes of the people.
        groups: Group labels.
        cluster_row: Row of each box's person in `groups`, -1 if there is no label.
        rules: Rules that name the visibility.

    Returns:
        One element per box. The size is unknown if the person is covered, if the person's membership is hard or
        missing, or if a record of the frame could not be read.
    """
    everyone = rules.visibility == "any"
    certain = _take(groups.certain, cluster_row)
    member = (cluster_row >= 0) & (certain | everyone) & ~boxes.covered
    group, _ = group_rows(boxes.frame, np.where(member, _take(groups.value, cluster_row), -1))
    frame = np.cumsum(begins(boxes.frame)) - 1
    counted = member & (boxes.clear | everyone)
    counts, members, doubts, hard = (
        np.bincount(key, weights=people).astype(np.int64)[key]
        for key, people in ((group, counted), (group, member), (frame, ~member & ~boxes.covered), (group, ~certain))
    )
    sized = member & np.isin(boxes.frame, line.frames_of("2d"))
    if everyone and sized.any():
        sized &= (doubts + hard == 0) & ~_may_lack_members(line, boxes, groups, cluster_row)
    return 1 + counts - counted, members + doubts, sized


def _may_lack_members(line: Timeline, boxes: Boxes, groups: Facts, cluster_row: Ints) -> Bools:
    """Return for each box whether a member of the person's group may be absent for a moment.

    Such a member has no box at the frame, but a box within one second of it. A person without a group label may be such
    a member of any group. A frame that could not be read may have such members of any group.
    """
    annotated, bare = line.frames_of("2d"), np.flatnonzero(cluster_row < 0)
    _, code = rank_values(groups.value)
    frame, track = np.append(groups.frame, boxes.frame[bare]), np.append(groups.track, boxes.track[bare])
    cluster = np.append(code, np.full(len(bare), -1))
    around = np.arange(-KEYFRAME_STEP, KEYFRAME_STEP + 1)
    absences = []
    for near in (frame + shift for shift in around):
        absent = np.isin(near, annotated) & (boxes.rows(near, track) < 0)
        absences.append(np.stack([near[absent], cluster[absent]]))
    frame, cluster = np.hstack(absences)
    grid = Grid(int(annotated[0]) - KEYFRAME_STEP, int(annotated[-1]) + KEYFRAME_STEP, step_of(annotated))
    # Beyond the ends of the 2D layer, frames are unread only if boxes or groups show that labelling goes on.
    labelled = np.concatenate([boxes.frame, annotated, line.frames_of("groups")])
    unread = np.setdiff1d(np.arange(labelled.min(), labelled.max() + 1), annotated)
    unread = unread[grid.holds(unread)]
    doubtful = np.append(frame[cluster < 0], unread[:, None] + around)
    lacking = paired(frame, cluster)[cluster >= 0]
    return np.isin(paired(boxes.frame, _take(code, cluster_row)), lacking) | np.isin(boxes.frame, doubtful)


def _take(values: npt.NDArray[N], row: Ints) -> npt.NDArray[N]:
    """Return the values at rows, and zero if the row is -1."""
    return np.append(values, np.zeros(1, values.dtype))[row]
