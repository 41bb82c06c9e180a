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
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.schema.rules import FPS, frames
from jrdb_avr.schema.tables import ANNOTATIONS

from . import fields
from .columns import Bools, Distinct, Ints, Refusals, constant, first_of_equal, known_frames, nullable, person_keys
from .labelfile import RecordReader, read_frames
from .problems import Problems
from .reading import Reading
from .records import BAD, OTHER, record_parts, repaired_label, track_codes, unpacked
from .report import Heading
from .scene_people import read_located, rows_of, wrap

CHUNK: Final = 20_000
NUMBERS: Final = ("cx", "cy", "cz", "l", "w", "h", "rot_z")
Floats = npt.NDArray[np.float64]


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
    num_points: int | float | None = None
    interpolated: bool | None = None
    no_eval: bool | None = None


NO_ATTRIBUTES: Final = Attributes()


class Record(msgspec.Struct, gc=False):
    """One person in one frame."""

    label_id: str
    box: Box
    attributes: Attributes | None = None


_READ_ONCE: Final = ("label_id", "box")


def load_3d(path: Path, sequence: str, problems: Problems) -> Reading:
    """The table `boxes_3d` of a label file.

    Raises InputError if the file as a whole cannot be used.
    """
    columns = _Columns()
    reader = RecordReader(Record, _repair, _READ_ONCE)
    known = []
    for frame, key, raw in read_frames(path, ("pcd", "pcb"), problems):
        found = reader.read(raw, key, problems)
        if found is not None:
            known.append(frame)
            columns.add(frame, found[0])
    columns.flush()
    table = _table(columns, sequence, problems)
    frames = known_frames(np.array(sorted(known), np.int64), table["frame"].to_numpy().astype(np.int64))
    return Reading({"boxes_3d": table}, {"3d": frames})


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


class _Columns:
    """Records turned into numbers, chunk by chunk."""

    def __init__(self) -> None:
        self.labels = Distinct()
        self.flags = Distinct()
        self.parts: dict[str, list[npt.NDArray[Any]]] = {
            name: [] for name in ("frame", "label", "numbers", "distance", "points", "flags")
        }
        self._records: list[Record] = []
        self._frames: list[int] = []
        self._counts: list[int] = []

    def add(self, frame: int, records: list[Record]) -> None:
        self._records += records
        self._frames.append(frame)
        self._counts.append(len(records))
        if len(self._records) >= CHUNK:
            self.flush()

    def flush(self) -> None:
        records, n, parts = self._records, len(self._records), self.parts
        parts["frame"].append(np.repeat(np.array(self._frames, np.int64), self._counts))
        numbers = chain.from_iterable(map(attrgetter(*NUMBERS), map(attrgetter("box"), records)))
        parts["numbers"].append(np.fromiter(numbers, np.float64, n * len(NUMBERS)).reshape(n, len(NUMBERS)))
        labels = map(attrgetter("label_id"), records)
        parts["label"].append(np.fromiter(map(self.labels.__getitem__, labels), np.int64, n))
        attributes = [item or NO_ATTRIBUTES for item in map(attrgetter("attributes"), records)]
        for name, key in (("distance", "distance"), ("points", "num_points")):
            # None becomes NaN: numbers of a file are finite by now.
            parts[name].append(np.array(list(map(attrgetter(key), attributes)), np.float64))
        flags = map(attrgetter("interpolated", "no_eval"), attributes)
        parts["flags"].append(np.fromiter(map(self.flags.__getitem__, flags), np.int64, n))
        self._records, self._frames, self._counts = [], [], []


def _table(columns: _Columns, sequence: str, problems: Problems) -> pa.Table:
    parts = {name: np.concatenate(arrays) for name, arrays in columns.parts.items()}
    frame: Ints = parts["frame"]
    refusals = Refusals(frame, "pcd", problems)
    rows, track = _keep(columns, parts, refusals)
    frame = frame[rows]
    refusals = Refusals(frame, "pcd", problems)
    distance, points = parts["distance"][rows], parts["points"][rows]
    wrong = ~np.isnan(distance) & ~((distance >= 0) & (distance <= fields.MAX_METRE))
    refusals.count(wrong, "field", "number out of range", "attributes.distance", lambda row: float(distance[row]))
    odd = ~np.isnan(points) & ~((points >= 0) & (points < 2**31) & (points == np.floor(points)))
    refusals.count(odd, "field", "not a count", "attributes.num_points", lambda row: float(points[row]))
    flags = list(columns.flags)
    flag_code = pa.array(parts["flags"][rows])
    return pa.table(
        {
            "sequence": constant(sequence, len(rows)),
            "frame": frame,
            "track": track,
            **{name: parts["numbers"][rows, i] for i, name in enumerate(NUMBERS)},
            "distance": nullable(distance, wrong | np.isnan(distance), pa.float64()),
            "num_points": nullable(np.where(odd, 0, np.nan_to_num(points)), odd | np.isnan(points), pa.int32()),
            "interpolated": pa.array([flag[0] for flag in flags], pa.bool_()).take(flag_code),
            "no_eval": pa.array([flag[1] for flag in flags], pa.bool_()).take(flag_code),
        }
    ).cast(ANNOTATIONS["boxes_3d"])


def _keep(columns: _Columns, parts: dict[str, npt.NDArray[Any]], refusals: Refusals) -> tuple[Ints, Ints]:
    """Rows to keep, sorted by (frame, track), and their tracks."""
    labels = list(columns.labels)
    code, numbers = parts["label"], parts["numbers"]
    track = track_codes(labels, code)

    def label(row: int) -> object:
        return labels[code[row]]

    def box(row: int) -> object:
        return dict(zip(NUMBERS, numbers[row].tolist(), strict=True))

    refusals.count(track == OTHER, "record", "label_id is not of a tracked person", "label_id", label)
    refusals.count(track == BAD, "record", "label_id is not pedestrian:N", "label_id", label)
    person: Bools = track >= 0
    wild = person & ~(np.abs(numbers) <= fields.MAX_METRE).all(axis=1)
    refusals.count(wild, "record", "box: not finite or kilometres away", "box", box)
    flat = person & ~wild & ~(numbers[:, 3:6] > 0).all(axis=1)
    refusals.count(flat, "record", "box: length, width or height is not positive", "box", box)
    usable = np.flatnonzero(person & ~wild & ~flat)
    order, first = first_of_equal(person_keys(parts["frame"][usable], track[usable]))
    again = np.zeros(len(track), np.bool_)
    again[usable[order[~first]]] = True
    refusals.count(again, "record", "same person twice in a frame, the first is kept", "label_id", label)
    rows = usable[order[first]]
    return rows, track[rows]
