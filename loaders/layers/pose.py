"""The pose layer: `labels_2d_pose_stitched_coco/<sequence>.json` -> the annotation table `poses`.

Seventeen points per person in stitched pixels, kept as written: they may lie past column 3760 or before column 0, and
points that are occluded have coordinates too. Only part of the people have a pose, so that a missing one says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records as fields
from jrdb_avr.loaders.labelfiles.coco import (
    ListReader,
    Number,
    crowded,
    known_images,
    open_coco,
    place_of,
    read_images,
    repaired_number,
)
from jrdb_avr.loaders.labelfiles.columns import Refusals, constant, first_of_equal, known_frames, mask_of, person_keys
from jrdb_avr.loaders.labelfiles.records import record_parts
from jrdb_avr.loaders.layers.layer import Reading
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.tables import ANNOTATIONS

POINTS: Final = 17
VALUES: Final = 3 * POINTS
"""x, y and visibility of each point."""


class Annotation(msgspec.Struct, gc=False):
    """One person in one image. Keypoints stay raw until a chunk of them is decoded."""

    image_id: Number
    track_id: Number
    keypoints: msgspec.Raw = msgspec.Raw(b"")
    id: int | str | None = None


_SEVENTEEN: Final = tuple[(float,) * VALUES]  # type: ignore[misc]
_ROW: Final = msgspec.json.Decoder(_SEVENTEEN)
_ROWS: Final = msgspec.json.Decoder(list[_SEVENTEEN])  # type: ignore[valid-type]


def load_pose(path: Path, sequence: str, problems: Problems) -> Reading:
    """Read a pose file. Raises InputError if the file as a whole cannot be used."""
    file = open_coco(path, problems)
    images = read_images(file, sequence, problems)
    parts: list[tuple[Ints, Ints, Floats]] = []
    for chunk in _ANNOTATIONS.read(file, "annotations", problems):
        n = len(chunk)
        ids = list(map(attrgetter("id"), chunk))
        image = np.fromiter(map(attrgetter("image_id"), chunk), np.int64, n)
        track = np.fromiter(map(attrgetter("track_id"), chunk), np.int64, n)
        frame = known_images(images, image, ids.__getitem__, problems)
        parts.append(_usable(frame, track, list(map(attrgetter("keypoints"), chunk)), problems))
    frame = np.concatenate([part[0] for part in parts])
    track = np.concatenate([part[1] for part in parts])
    values = np.concatenate([part[2] for part in parts])
    parts.clear()
    refusals = Refusals(frame, "jpg", problems)
    full = crowded(frame, refusals)
    usable = np.flatnonzero(~full)
    order, first = first_of_equal(person_keys(frame[usable], track[usable]))
    again = mask_of(usable[order[~first]], len(frame))
    reason = "same person twice in a frame, the first is kept"
    refusals.count(again, "record", reason, "track_id", lambda row: int(track[row]))
    rows = usable[order[first]]
    known = known_frames(np.setdiff1d(images.frame, frame[full]), frame[rows])
    if not np.array_equal(rows, np.arange(len(frame))):
        frame, track, values = frame[rows], track[rows], values[rows]
    return Reading({"poses": _table(sequence, frame, track, values)}, {"pose": known})


def _usable(frame: Ints, track: Ints, raws: Sequence[msgspec.Raw], problems: Problems) -> tuple[Ints, Ints, Floats]:
    """Frame, track and values (n, 51) of the records of a chunk whose every part can be used."""
    refusals = Refusals(frame, "jpg", problems)
    person = (track >= 0) & (track <= fields.MAX_TRACK)
    refusals.count((frame >= 0) & ~person, "record", "number out of range", "track_id", lambda row: int(track[row]))
    rows = np.flatnonzero((frame >= 0) & person)
    given, values = _decoded(rows, raws, refusals)
    points = values.reshape(-1, POINTS, 3)
    near: Bools = np.asarray((np.abs(points[:, :, :2]) <= fields.MAX_PIXEL).all(axis=(1, 2)))
    code = points[:, :, 2]
    coded: Bools = np.asarray(((code == 2) | (code == 1) | (code == 0)).all(axis=1))
    for fault, reason in ((~near, "far outside the image"), (near & ~coded, "visibility is not 0, 1 or 2")):
        wrong = mask_of(given[fault], len(frame))
        refusals.count(wrong, "record", f"keypoints: {reason}", "keypoints", lambda row: bytes(raws[row]))
    good = near & coded
    if good.all():
        return frame[given], track[given], values
    return frame[given[good]], track[given[good]], values[good]


def _decoded(rows: Ints, raws: Sequence[msgspec.Raw], refusals: Refusals) -> tuple[Ints, Floats]:
    """Those of the rows that have 51 finite numbers, and the numbers."""
    here = []
    for row in rows.tolist():
        raw = bytes(raws[row])
        if raw in fields.ABSENT:
            refusals.add("record", "keypoints: missing", "keypoints", row, raw, 1)
        else:
            here.append(row)
    found: Sequence[Sequence[float]]
    try:
        found = _ROWS.decode(b"[" + b",".join([raws[row] for row in here]) + b"]")
        if len(found) != len(here):  # one of the raw values is no single one
            raise msgspec.DecodeError
    except msgspec.DecodeError:
        found, kept = [], []
        for row in here:
            raw = bytes(raws[row])
            try:
                found.append(_numbers(raw))
            except ValueError as error:
                refusals.add("record", f"keypoints: {error}", "keypoints", row, raw, 1)
            else:
                kept.append(row)
        here = kept
    flat = np.fromiter(chain.from_iterable(found), np.float64, VALUES * len(here))
    return np.array(here, np.int64), flat.reshape(-1, VALUES)


def _numbers(raw: bytes) -> Sequence[float]:
    """The keypoints of a record. Raises ValueError where they are not 51 finite numbers."""
    try:
        return _ROW.decode(raw)  # type: ignore[no-any-return]
    except (msgspec.DecodeError, RecursionError):
        value = fields.loose(raw)
    if not isinstance(value, list) or len(value) != VALUES:
        raise ValueError(f"not {VALUES} numbers")
    return [fields.number(item) for item in value]


def _table(sequence: str, frame: Ints, track: Ints, values: Floats) -> pa.Table:
    schema = ANNOTATIONS["poses"]
    points = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), VALUES)
    columns: dict[str, Any] = {"frame": frame, "track": track, "keypoints": points}
    return pa.table({"sequence": constant(sequence, len(frame)), **columns}).cast(schema)


def _repair(raw: bytes, frame: str, problems: Problems) -> Annotation | None:
    """What can be used of a record that does not decode as it stands; None, with the reason counted, if nothing."""
    parts = record_parts(raw, frame, problems)
    if parts is None:
        return None
    where = place_of(parts)
    image = repaired_number(parts, "image_id", where, problems)
    track = None if image is None else repaired_number(parts, "track_id", where, problems)
    if image is None or track is None:
        return None
    return Annotation(image, track, msgspec.Raw(parts.get("keypoints", b"")), where.removeprefix("annotation "))


_ANNOTATIONS: Final = ListReader(Annotation, _repair, ("image_id", "track_id", "keypoints"))
