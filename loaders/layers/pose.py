"""The pose layer: `labels_2d_pose_stitched_coco/<sequence>.json` -> the annotation table `poses`.

Seventeen points per person in stitched pixels, stored as written: they may lie past column 3760 or before column 0, and
points that are occluded have coordinates too. Only part of the people have a pose, so that a missing one says nothing.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.coco import (
    NUMBER,
    Images,
    Number,
    annotation_frames,
    annotation_reader,
    crowded,
    open_coco,
    read_list,
)
from jrdb_avr.loaders.labelfiles.columns import LayerTables, Refusals, first_of_equal, known_frames, mask_of
from jrdb_avr.loaders.labelfiles.json import ABSENT, BROKEN, NOTHING, parse
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Floats, Ints

POINTS: Final = 17
VALUES: Final = 3 * POINTS
"""x, y and visibility of each point."""


class PoseAnnotation(msgspec.Struct, gc=False):
    """One person in one image. Keypoints stay raw until a chunk of them is decoded."""

    image_id: Number
    track_id: Number
    keypoints: msgspec.Raw = NOTHING
    id: msgspec.Raw = NOTHING


_READER: Final = annotation_reader(
    PoseAnnotation, {"image_id": NUMBER, "track_id": NUMBER}, ("image_id", "track_id", "keypoints")
)
_SEVENTEEN: Final = tuple[(float,) * VALUES]  # type: ignore[misc]
_PACKED: Final = struct.Struct(f"{VALUES}d")
_ROWS: Final = msgspec.json.Decoder(list[_SEVENTEEN])  # type: ignore[valid-type]


def load_pose(path: Path, problems: Problems) -> LayerTables:
    """Read a pose file. Raises InputError if the file as a whole cannot be used."""
    file = open_coco(path, problems)
    images = Images(file, problems)
    parts: list[tuple[Ints, Ints, Floats]] = []
    for chunk in read_list(file, "annotations", _READER, problems):
        track = np.fromiter(map(attrgetter("track_id"), chunk), np.int64, len(chunk))
        frame = annotation_frames(chunk, images, problems)
        rows, points = _usable(frame, track, [annotation.keypoints for annotation in chunk], problems)
        parts.append((frame[rows], track[rows], points))
    frame, track, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    parts.clear()
    refusals = Refusals(frame, problems)
    full = crowded(frame, refusals)
    usable = np.flatnonzero(~full)
    order, first = first_of_equal(frame[usable], track[usable])
    again = mask_of(usable[order[~first]], len(frame))
    reason = "same person twice in a frame, the first is kept"
    refusals.count(again, "record", reason, "track_id", lambda row: int(track[row]))
    rows = usable[order[first]]
    known = known_frames(np.setdiff1d(images.frame, frame[full]), frame[rows])
    if not np.array_equal(rows, np.arange(len(frame))):
        frame, track, values = frame[rows], track[rows], values[rows]
    points = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), VALUES)
    return LayerTables({"poses": pa.table({"frame": frame, "track": track, "keypoints": points})}, {"pose": known})


def _usable(frame: Ints, track: Ints, raws: Sequence[msgspec.Raw], problems: Problems) -> tuple[Ints, Floats]:
    """The rows of a chunk whose every part can be used, and their values (n, 51)."""
    refusals = Refusals(frame, problems)
    person = (track >= 0) & (track <= records.MAX_TRACK)
    refusals.count((frame >= 0) & ~person, "record", "number out of range", "track_id", lambda row: int(track[row]))
    rows, values = _decoded(np.flatnonzero((frame >= 0) & person).tolist(), raws, refusals)
    points = values.reshape(-1, POINTS, 3)
    codes = points[:, :, 2]
    near, coded = np.ones((2, len(rows)), np.bool_)
    near[np.nonzero(np.abs(points[:, :, :2]) > records.MAX_PIXEL)[0]] = False
    coded[np.nonzero((codes != 0) & (codes != 1) & (codes != 2))[0]] = False
    for fault, reason in ((~near, "far outside the image"), (near & ~coded, "visibility is not 0, 1 or 2")):
        wrong = mask_of(rows[fault], len(frame))
        refusals.count(wrong, "record", f"keypoints: {reason}", "keypoints", lambda row: bytes(raws[row]))
    good = near & coded
    return (rows, values) if good.all() else (rows[good], values[good])


def _decoded(rows: list[int], raws: Sequence[msgspec.Raw], refusals: Refusals) -> tuple[Ints, Floats]:
    """Those of the rows that have 51 finite numbers, and the numbers."""
    absent = [row for row in rows if bytes(raws[row]) in ABSENT]
    for row in absent:
        refusals.add("record", "keypoints: missing", "keypoints", row, bytes(raws[row]), 1)
    rows = [row for row in rows if bytes(raws[row]) not in ABSENT] if absent else rows
    found: Any = ()
    with contextlib.suppress(*BROKEN):
        found = _ROWS.decode(b"[" + b",".join([raws[row] for row in rows]) + b"]")
    if len(found) != len(rows):  # one of the raw values is no single one
        found = {}
        for row in rows:
            raw = bytes(raws[row])
            try:
                found[row] = records.numbers(parse(raw), VALUES, str(VALUES))
            except ValueError as error:
                refusals.add("record", f"keypoints: {error}", "keypoints", row, raw, 1)
        rows, found = list(found), found.values()
    # Packed row by row, numbers take a third of the time of one at a time.
    values = np.frombuffer(b"".join([_PACKED.pack(*row) for row in found]), np.float64)
    return np.array(rows, np.int64), values.reshape(-1, VALUES)
