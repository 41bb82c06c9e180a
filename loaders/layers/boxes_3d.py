"""The 3D layer: `labels_3d/<sequence>.json` -> the annotation table `boxes_3d`.

Metres in the robot frame: x forward, y left, z up, the box's centre. `rot_z` is kept as written; the heading that
follows from it is `wrap(pi - rot_z)`, which `heading_check` compares with how people move.
"""

from __future__ import annotations

from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.intervals.people import read_located, rows_of, wrap
from jrdb_avr.loaders.labelfiles import records as fields
from jrdb_avr.loaders.labelfiles.columns import (
    Distinct,
    Refusals,
    constant,
    encoded,
    known_frames,
    nullable,
    person_keys,
)
from jrdb_avr.loaders.labelfiles.frames import RecordReader
from jrdb_avr.loaders.labelfiles.gather import Columns, People, gather, keep_people, numbered
from jrdb_avr.loaders.labelfiles.records import record_parts, repaired_label, unpacked
from jrdb_avr.loaders.layers.layer import Reading
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.loaders.report import Heading
from jrdb_avr.schema.rules import FPS, frames
from jrdb_avr.schema.tables import ANNOTATIONS

NUMBERS: Final = ("cx", "cy", "cz", "l", "w", "h", "rot_z")


class Box(msgspec.Struct, gc=False):
    """The `box` object."""

    cx: float
    cy: float
    cz: float
    l: float  # noqa: E741  the file's own name
    w: float
    h: float
    rot_z: float


class Attributes(msgspec.Struct, gc=False, frozen=True):
    """The `attributes` object; null where missing."""

    distance: float | None = None
    num_points: float | None = None
    interpolated: bool | None = None
    no_eval: bool | None = None


NO_ATTRIBUTES: Final = Attributes()


class Record(msgspec.Struct, gc=False):
    """One person in one frame."""

    label_id: str
    box: Box
    attributes: Attributes | None = None


_READ_ONCE: Final = ("label_id", "box", "attributes")


def load_3d(path: Path, sequence: str, problems: Problems) -> Reading:
    """The table `boxes_3d` of a label file.

    Raises InputError if the file as a whole cannot be used.
    """
    labels, flags = Distinct(), Distinct()
    reader = RecordReader(Record, _repair, _READ_ONCE)
    gathered = gather(path, ("pcd", "pcb"), reader, lambda records: _take(records, labels, flags), problems)
    columns = gathered.columns()
    people = _kept(columns, list(labels), problems)
    table = _table(columns, list(flags), people, sequence, problems)
    known = np.array(sorted(gathered.known), np.int64)
    return Reading({"boxes_3d": table}, {"3d": known_frames(known, people.frame)})


def heading_check(table: pa.Table) -> Heading:
    """Median angle between heading and displacement over one second, of people who moved more than half a metre.

    Positions are in the robot's frame, so a driving robot blurs the measure; a reversed sign shows anyway.
    """
    located = read_located(table)
    step = frames(1.0)
    later = rows_of(located.keys, person_keys(located.frame + step, located.track))
    now = np.flatnonzero(later >= 0)
    moved = located.center[later[now], :2] - located.center[now, :2]
    fast = np.hypot(moved[:, 0], moved[:, 1]) > MOVING_MPS * step / FPS
    way = np.arctan2(moved[fast, 1], moved[fast, 0])
    off = np.degrees(np.abs(wrap(located.heading[now][fast] - way)))
    return Heading(len(off), float(np.median(off)) if len(off) else None)


MOVING_MPS: Final = 0.5


def _repair(raw: bytes, frame: str, problems: Problems) -> Record | None:
    """What can be used of a record that does not decode as it stands; None, with the reason counted, if nothing."""
    parts = record_parts(raw, frame, problems)
    label = None if parts is None else repaired_label(parts, frame, problems)
    if parts is None or label is None:
        return None
    try:
        box = unpacked(parts.get("box", b"null"), "box", frame, problems)
        values = []
        for name in NUMBERS:
            if name not in box:
                raise ValueError(f"{name} is missing")
            values.append(fields.number(box[name]))
    except ValueError as error:
        problems.add("record", f"box: {error}", frame=frame, field="box", value=parts.get("box", b"missing"))
        return None
    return Record(label, Box(*values), _attributes(parts.get("attributes"), frame, problems))


def _attributes(raw: bytes | None, frame: str, problems: Problems) -> Attributes | None:
    if raw is None or raw == b"null":
        return None
    try:
        values = unpacked(raw, "attributes", frame, problems)
    except ValueError as error:
        problems.add("field", str(error), frame=frame, field="attributes", value=raw)
        return None
    usable: dict[str, Any] = {}
    for name in ("distance", "num_points", "interpolated", "no_eval"):
        value = values.get(name)
        read = fields.number if name in ("distance", "num_points") else fields.flag
        try:
            usable[name] = None if value is None else read(value)
        except ValueError as error:
            problems.add("field", str(error), frame=frame, field=f"attributes.{name}", value=value)
    return Attributes(**usable)


def _take(records: list[Record], labels: Distinct, flags: Distinct) -> Columns:
    n = len(records)
    numbers = chain.from_iterable(map(attrgetter(*NUMBERS), map(attrgetter("box"), records)))
    attributes = [item or NO_ATTRIBUTES for item in map(attrgetter("attributes"), records)]
    return {
        "label_id": numbered(labels, map(attrgetter("label_id"), records), n),
        "numbers": np.fromiter(numbers, np.float64, n * len(NUMBERS)).reshape(n, len(NUMBERS)),
        # None becomes NaN: numbers of a file are finite by now.
        "distance": np.array(list(map(attrgetter("distance"), attributes)), np.float64),
        "points": np.array(list(map(attrgetter("num_points"), attributes)), np.float64),
        "flags": numbered(flags, map(attrgetter("interpolated", "no_eval"), attributes), n),
    }


def _kept(columns: Columns, labels: list[str], problems: Problems) -> People:
    numbers = columns["numbers"]
    faults = [
        (np.asarray(~(np.abs(numbers) <= fields.MAX_METRE).all(axis=1)), "box: not finite or kilometres away"),
        (np.asarray(~(numbers[:, 3:6] > 0).all(axis=1)), "box: length, width or height is not positive"),
    ]

    def box(row: int) -> object:
        return dict(zip(NUMBERS, numbers[row].tolist(), strict=True))

    refusals = Refusals(columns["frame"], "pcd", problems)
    return keep_people(columns["frame"], labels, columns["label_id"], faults, box, refusals)


def _table(
    columns: Columns, flags: list[tuple[bool | None, bool | None]], people: People, sequence: str, problems: Problems
) -> pa.Table:
    columns = {name: column[people.row] for name, column in columns.items()}
    refusals = Refusals(people.frame, "pcd", problems)
    distance, points = columns["distance"], columns["points"]
    wrong = ~np.isnan(distance) & ~((distance >= 0) & (distance <= fields.MAX_METRE))
    refusals.count(wrong, "field", "number out of range", "attributes.distance", lambda row: float(distance[row]))
    odd = ~np.isnan(points) & ~((points >= 0) & (points < 2**31) & (points == np.floor(points)))
    refusals.count(odd, "field", "not a count", "attributes.num_points", lambda row: float(points[row]))
    flag_code = pa.array(columns["flags"])
    table = pa.table(
        {
            "sequence": constant(sequence, len(people.row)),
            "frame": people.frame,
            "track": people.track,
            **{name: columns["numbers"][:, i] for i, name in enumerate(NUMBERS)},
            "distance": nullable(distance, wrong | np.isnan(distance), pa.float64()),
            "num_points": nullable(np.where(odd, 0, np.nan_to_num(points)), odd | np.isnan(points), pa.int32()),
            "interpolated": pa.array([flag[0] for flag in flags], pa.bool_()).take(flag_code),
            "no_eval": pa.array([flag[1] for flag in flags], pa.bool_()).take(flag_code),
        }
    )
    return encoded(table, ANNOTATIONS["boxes_3d"])
