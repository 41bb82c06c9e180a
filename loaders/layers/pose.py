"""Loader of the pose layer, which makes the table `poses` from `labels_2d_pose_stitched_coco/<sequence>.json`.

A pose has seventeen key points of a person in pixels of the panorama. The points are stored as written, so a point may
be outside the columns 0 to 3760. An occluded point has coordinates too. Only some people have poses, so a missing pose
proves nothing.
"""

from __future__ import annotations

import struct
from operator import attrgetter
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.coco import ImageId, Images, ShortId, open_coco, read_chunks
from jrdb_avr.loaders.labelfiles.columns import LayerTables, Refusals, first_of_equal, known_frames, mask_of
from jrdb_avr.loaders.labelfiles.frames import RecordReader
from jrdb_avr.loaders.labelfiles.records import NOTHING
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Floats, Ints

POINTS: Final = 17
"""Number of key points of a pose."""
VALUES: Final = 3 * POINTS
"""Number of values of a pose: x, y and visibility of each key point."""


class PoseAnnotation(msgspec.Struct, gc=False):
    """Record of one person in one image."""

    image_id: ImageId
    track_id: ShortId
    keypoints: tuple[(float,) * VALUES]  # type: ignore[valid-type]
    id: msgspec.Raw = NOTHING


_READER: Final = RecordReader(PoseAnnotation)
_PACKED: Final = struct.Struct(f"{VALUES}d")


def load_pose(path: Path, problems: Problems) -> LayerTables:
    """Read a pose file.

    Args:
        path: label file.
        problems: counter of refused parts.

    Returns:
        The table `poses`, and the frames of the layer `pose`.

    Raises:
        InputError: If the file as a whole cannot be used.
    """
    file = open_coco(path)
    images = Images(file, path.stem, problems)
    parts: list[tuple[Ints, Ints, Floats]] = []
    for chunk in read_chunks(file.annotations, "annotation", _READER, problems):
        track = np.fromiter(map(attrgetter("track_id"), chunk), np.int64, len(chunk))
        frame = images.frames_of(chunk, problems)
        # Packing whole rows takes a third of the time of converting single numbers.
        packed = b"".join([_PACKED.pack(*annotation.keypoints) for annotation in chunk])
        values = np.frombuffer(packed, np.float64).reshape(-1, VALUES)
        rows = _usable(frame, values, problems)
        parts.append((frame[rows], track[rows], values[rows]))
    frame, track, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    parts.clear()
    order, first = first_of_equal(frame, track)
    again = mask_of(order[~first], len(frame))
    reason = "same person twice in a frame, the first is kept"
    Refusals(frame, problems).count(again, "record", reason, "track_id", lambda row: int(track[row]))
    rows = order[first]
    frames = known_frames(images.frame, frame[rows])
    points = pa.FixedSizeListArray.from_arrays(pa.array(values[rows].ravel()), VALUES)
    table = pa.table({"frame": frame[rows], "track": track[rows], "keypoints": points})
    return LayerTables({"poses": table}, {"pose": frames})


def _usable(frame: Ints, values: Floats, problems: Problems) -> Ints:
    """Return the indices of the poses that have a frame and usable key points. `values` has the shape (n, 51)."""
    refusals = Refusals(frame, problems)
    points = values.reshape(-1, POINTS, 3)
    near = (np.abs(points[:, :, :2]) <= records.MAX_PIXEL).all(axis=(1, 2))
    coded = np.isin(points[:, :, 2], (0, 1, 2)).all(axis=1)
    listed = frame >= 0
    for fault, reason in ((~near, "far outside the image"), (near & ~coded, "visibility is not 0, 1 or 2")):
        refusals.count(listed & fault, "record", f"keypoints: {reason}", "keypoints", lambda row: values[row].tolist())
    return np.flatnonzero(listed & near & coded)
