"""Loader of the 3D layer, which makes the annotation table `boxes_3d` from `labels_3d/<sequence>.json`.

The centre and the size of a box are in metres, in the frame of the robot: x forward, y left, z up. `rot_z` is stored as
written. A person's heading is `wrap(pi - rot_z)`, and `heading_check` compares the heading with the person's motion. If
a refused record may describe a person, all rows of the record's frame are dropped, because the label id of any other
box in the frame could be wrong too.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import chain
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.intervals.people import read_located, wrap
from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.columns import (
    Columns,
    Distinct,
    LayerTables,
    Refusals,
    known_frames,
    nullable,
    numbered,
    paired,
    rows_of,
)
from jrdb_avr.loaders.labelfiles.facts import keep_people
from jrdb_avr.loaders.labelfiles.frames import Fields, RecordReader, gather, take_fields
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.loaders.report import Heading
from jrdb_avr.schema.rules import FPS, frames

NUMBERS: Final = ("cx", "cy", "cz", "l", "w", "h", "rot_z")
"""Members of a box: centre, length, width and height in metres, and rotation in radians."""
MOVING_MPS: Final = 0.5
"""Minimum speed, in metres per second, of the people that the check of headings uses."""


class Attributes3D(msgspec.Struct, gc=False, frozen=True):
    """The object `attributes` of a record. A missing attribute is None."""

    distance: float | None = None
    num_points: float | None = None
    interpolated: bool | None = None
    no_eval: bool | None = None


Box: Final = msgspec.defstruct("Box", [(name, float) for name in NUMBERS], gc=False)


class Record3D(msgspec.Struct, gc=False):
    """Record of one person in one frame."""

    label_id: str
    box: Box  # type: ignore[valid-type]
    attributes: Attributes3D | None = None


_READER: Final = RecordReader(Record3D)


def load_3d(path: Path, problems: Problems) -> LayerTables:
    """Read a 3D label file.

    Args:
        path: label file.
        problems: counter of refused parts.

    Returns:
        The table `boxes_3d`, and the frames of the layer `3d`.

    Raises:
        InputError: If the file as a whole cannot be used.
    """
    codes: dict[str, Distinct] = defaultdict(Distinct)
    columns, listed, complete = gather(path, ("pcd", "pcb"), _READER, lambda fields: _take(fields, codes), problems)
    numbers = columns["numbers"]
    faults = [
        (np.asarray(~(np.abs(numbers) <= records.MAX_METRE).all(axis=1)), "box: not finite or kilometres away"),
        (np.asarray(~(numbers[:, 3:6] > 0).all(axis=1)), "box: length, width or height is not positive"),
    ]
    refusals = Refusals(columns["frame"], problems, "pcd")
    people = keep_people(
        columns, codes, refusals, faults, lambda row: dict(zip(NUMBERS, numbers[row].tolist(), strict=True))
    )
    in_whole = np.isin(people.frame, people.whole_frames(complete))
    people = people._replace(row=people.row[in_whole], frame=people.frame[in_whole], track=people.track[in_whole])
    columns = {name: column[people.row] for name, column in columns.items()}
    refusals = Refusals(people.frame, problems, "pcd")
    distance, points = columns["distance"], columns["points"]
    far = ~np.isnan(distance) & ~((distance >= 0) & (distance <= records.MAX_METRE))
    refusals.count(far, "field", "number out of range", "attributes.distance", lambda row: float(distance[row]))
    odd = ~np.isnan(points) & ~((points >= 0) & (points < 2**31) & (points == np.floor(points)))
    refusals.count(odd, "field", "not a count", "attributes.num_points", lambda row: float(points[row]))
    flags = zip(*codes["flags"], strict=True) if codes["flags"] else ((), ())
    interpolated, no_eval = (pa.array(values, pa.bool_()).take(pa.array(columns["flags"])) for values in flags)
    table = pa.table(
        {
            "frame": people.frame,
            "track": people.track,
            **{name: columns["numbers"][:, i] for i, name in enumerate(NUMBERS)},
            "distance": nullable(distance, far | np.isnan(distance), pa.float64()),
            "num_points": nullable(np.where(odd, 0, np.nan_to_num(points)), odd | np.isnan(points), pa.int32()),
            "interpolated": interpolated,
            "no_eval": no_eval,
        }
    )
    listed_frames = known_frames(np.array(sorted(listed), np.int64), people.frame)
    return LayerTables({"boxes_3d": table}, {"3d": listed_frames})


def _take(fields: Fields, codes: dict[str, Distinct]) -> Columns:
    """Return the columns of a batch of records.

    The column `numbers` has the shape (n, 7). Each row has the members of a box in the order of `NUMBERS`.
    """
    n = len(fields["box"])
    numbers = chain.from_iterable(map(msgspec.structs.astuple, fields["box"]))
    attributes: list[Any] = [item or Attributes3D() for item in fields["attributes"]]
    return {
        **take_fields(fields, ("label_id",), codes),
        "numbers": np.fromiter(numbers, np.float64, n * len(NUMBERS)).reshape(n, len(NUMBERS)),
        # JSON has no NaN, so NaN can mean "missing" from here on. numpy converts None to NaN.
        "distance": np.array([item.distance for item in attributes], np.float64),
        "points": np.array([item.num_points for item in attributes], np.float64),
        "flags": numbered(codes["flags"], [(item.interpolated, item.no_eval) for item in attributes], n),
    }


def heading_check(table: pa.Table) -> Heading:
    """Compare the headings of people faster than `MOVING_MPS` with their displacements over one second.

    Positions are relative to the robot, so the angles are less exact if the robot drives. A heading with the wrong sign
    is noticed nevertheless.

    Args:
        table: annotation table `boxes_3d`.

    Returns:
        The number of compared displacements, and the median angle in degrees between heading and displacement.
    """
    located = read_located(table)
    step = frames(1.0)
    later = rows_of(located.keys, paired(located.frame + step, located.track))
    now = np.flatnonzero(later >= 0)
    moved = located.center[later[now], :2] - located.center[now, :2]
    fast = np.hypot(moved[:, 0], moved[:, 1]) > MOVING_MPS * step / FPS
    direction = np.arctan2(moved[fast, 1], moved[fast, 0])
    off = np.degrees(np.abs(wrap(located.heading[now][fast] - direction)))
    return Heading(len(off), float(np.median(off)) if len(off) else None)
