"""The interval table `sightings`: everything known of a person in one frame, one row per 2D box."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import INTERVALS
from jrdb_avr.schema.vocabulary import DISTANCE_WORDS, ROBOT_SECTORS

from .columns import begins, constant, nullable, person_keys, texts
from .scene_people import Boxes, Faces, Groups, Labels, Located, rows_of
from .timeline import Timeline
from .words import distance_word, robot_sector

N = TypeVar("N", bound=np.generic)


def sightings_table(
    line: Timeline,
    boxes: Boxes,
    labels: Labels,
    groups: Groups,
    located: Located,
    listed: Mapping[str, Ints],
    faces: Faces,
    rules: LoadRules,
) -> pa.Table:
    """All sightings of a sequence, by frame and track. `listed`: per layer, the keys whose list was read."""
    n = len(boxes.frame)
    cluster_row = rows_of(person_keys(groups.frame, groups.track), boxes.keys)
    sizes, size_known = group_sizes(line, boxes, groups, cluster_row)
    place = rows_of(located.keys, boxes.keys)
    here = place >= 0
    face = rows_of(faces.keys, boxes.keys)
    sector, sector_other = robot_sector(boxes.angle, rules)
    distance = _take(located.distance, place)
    word, word_other = distance_word(distance, rules)
    center = np.stack([_take(located.center[:, i], place) for i in range(3)])
    return pa.table(
        {
            "sequence": constant(line.sequence, n),
            "frame": boxes.frame,
            "track": boxes.track,
            **{name: boxes.box[:, i] for i, name in enumerate("xywh")},
            "angle": boxes.angle,
            "occlusion": boxes.occlusion,
            "no_eval": boxes.no_eval,
            "clear": boxes.clear,
            "face_visible": nullable(_take(faces.visible, face), face < 0, pa.bool_()),
            "listed": boxes.listed,
            **{f"{layer}_listed": rows_of(keys, boxes.keys) >= 0 for layer, keys in listed.items()},
            "pose": texts(labels.names, certain_pose(boxes, labels)),
            "cluster": nullable(_take(groups.cluster, cluster_row), cluster_row < 0, pa.int64()),
            "group_size": nullable(sizes, ~size_known, pa.int32()),
            "sector": texts(ROBOT_SECTORS, sector),
            "sector_other": texts(ROBOT_SECTORS, sector_other),
            "located": here,
            "distance": nullable(distance, ~here, pa.float64()),
            "distance_word": texts(DISTANCE_WORDS, np.where(here, word, -1)),
            "distance_word_other": texts(DISTANCE_WORDS, np.where(here, word_other, -1)),
            **{name: nullable(center[i], ~here, pa.float64()) for i, name in enumerate(("cx", "cy", "cz"))},
            "heading": nullable(_take(located.heading, place), ~here, pa.float64()),
        }
    ).cast(INTERVALS["sightings"])


def certain_pose(boxes: Boxes, labels: Labels) -> Ints:
    """Per box: the action code of its one certain pose, -1 where the pose is unknown."""
    pose = labels.certain & labels.is_pose[labels.action] if len(labels.action) else labels.certain
    row = boxes.rows(labels.frame[pose], labels.track[pose])
    result = np.full(len(boxes.frame), -1, np.int64)
    result[row[row >= 0]] = labels.action[pose][row >= 0]
    return result


def group_sizes(line: Timeline, boxes: Boxes, groups: Groups, cluster_row: Ints) -> tuple[Ints, Bools]:
    """Per box: people of the frame in the same cluster, oneself included, and whether that is known.

    It is known where every person of the frame could be read and has a cluster row, and no row of the cluster is hard:
    somebody without a row might belong to any group.
    """
    has_row = cluster_row >= 0
    cluster, certain = _take(groups.cluster, cluster_row), _take(groups.certain, cluster_row)
    # A person without a row takes part in no cluster; -1 - row keeps it apart from its neighbours.
    order = np.lexsort((cluster, ~has_row, boxes.frame))
    frame, cluster, has_row, certain = boxes.frame[order], cluster[order], has_row[order], certain[order]
    group = np.cumsum(begins(frame, cluster) | ~has_row) - 1
    members = np.bincount(group)
    hard = np.bincount(group, weights=~certain) > 0
    complete = np.isin(frame, line.frames_of("2d")) & ~np.isin(frame, frame[~has_row])
    sizes, known = np.empty(len(frame), np.int64), np.empty(len(frame), np.bool_)
    sizes[order] = members[group]
    known[order] = complete & has_row & ~hard[group]
    return sizes, known


def _take(values: npt.NDArray[N], row: Ints) -> npt.NDArray[N]:
    """Values at rows; zero where the row is -1."""
    if not len(values):
        return np.zeros(len(row), values.dtype)
    return np.where(row >= 0, values[row], np.zeros(1, values.dtype))
