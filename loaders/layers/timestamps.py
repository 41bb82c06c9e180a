"""Loader of the times of frames, which makes the table `timestamps` from two files in `timestamps/<sequence>`.

`frames_img.json` has the stamps of images, and `frames_pc.json` has the stamps of point clouds. A stamp is in seconds
since the epoch, and each frame has at most one stamp per sensor. The frame of an entry is its `frame_id`, or the number
in the base names of its images or clouds. If an entry has both and they differ, the entry is refused. If the stamps of
a file do not strictly increase with the frames, the whole file is refused.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles.columns import LayerTables, constant
from jrdb_avr.loaders.labelfiles.frames import RecordReader, decode_file
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Floats, Ints
from jrdb_avr.schema.errors import InputError

_MAX_ENTRIES: Final = 100_000
"""Maximum entries of a file."""
MAX_SECONDS: Final = 1e11
"""Maximum stamp in seconds. A larger number must have another unit."""


SENSORS: Final = {"clouds": ("frames_pc.json", "pcd|pcb|bin"), "images": ("frames_img.json", "jpg|jpeg|png")}
"""File of stamps, and pattern of the suffixes of images or clouds, by sensor. The table `timestamps` has this order."""


class _Listed(msgspec.Struct, gc=False):
    url: str | None = None


class StampedFrame(msgspec.Struct, gc=False):
    """Entry of a file: the stamp of a frame, and the images or clouds of the frame."""

    timestamp: Annotated[float, msgspec.Meta(ge=0, le=MAX_SECONDS)]
    frame_id: Annotated[int, msgspec.Meta(ge=0, le=999_999)] | None = None
    cameras: list[_Listed] | None = None
    pointclouds: list[_Listed] | None = None


class _File(msgspec.Struct):
    data: msgspec.Raw


_READER: Final = RecordReader(StampedFrame)


def load_timestamps(folder: Path, problems: Problems) -> LayerTables:
    """Read the two files of a sequence. If one file is missing or unusable, the other file is still used.

    Args:
        folder: folder `timestamps/<sequence>`.
        problems: counter of refused files and entries.

    Returns:
        The table `timestamps`, and the frames of the layer `timestamps`.

    Raises:
        InputError: If the folder has neither file, or if no file in it is usable.
    """
    columns: dict[str, tuple[Ints, Floats]] = {}
    errors = []
    for sensor, (file, suffixes) in SENSORS.items():
        try:
            if os.path.lexists(folder / file):
                columns[sensor] = _stamps(folder / file, suffixes, problems)
        except InputError as error:
            errors.append(error)
        except OSError as error:
            errors.append(InputError(f"{file}: cannot be read: {error.strerror}", file=file))
    if not columns:
        raise errors[0] if errors else InputError("the folder has neither frames_img.json nor frames_pc.json")
    for unusable in errors:
        problems.add("file", str(unusable))
    table = pa.concat_tables(
        pa.table({"sensor": constant(name, len(frame)), "frame": frame, "timestamp": seconds})
        for name, (frame, seconds) in columns.items()
    )
    frames = np.unique(np.concatenate([frame for frame, _ in columns.values()]), return_counts=True)
    return LayerTables({"timestamps": table}, {"timestamps": frames})


def frame_rate(frame: Ints, seconds: Sequence[float]) -> float | None:
    """Return the median frame rate between successive stamps, in frames per second.

    The result is None if there are fewer than two stamps.
    """
    if len(frame) < 2:
        return None
    return float(np.median(np.diff(frame) / np.diff(np.asarray(seconds, np.float64))))


def _stamps(path: Path, suffixes: str, problems: Problems) -> tuple[Ints, Floats]:
    """Return the frames of the usable entries in ascending order, and the stamp of each frame in seconds."""
    try:
        entries, refused = _READER.read(decode_file(path, _File).data, problems, lambda raw: path.name)
    except msgspec.DecodeError:
        raise InputError(f'{path.name}: there is no list "data"', file=path.name) from None
    if len(entries) + refused > _MAX_ENTRIES:
        raise InputError(f"{path.name}: more than {_MAX_ENTRIES} entries", file=path.name)
    stamps: list[tuple[int, float]] = []
    form = re.compile(rf"([0-9]{{6}})\.(?:{suffixes})")
    for entry in entries:
        names = [(listed.url or "").rpartition("/")[2] for listed in entry.cameras or entry.pointclouds or ()]
        frames = {int(match[1]) for match in map(form.fullmatch, names) if match}
        if entry.frame_id is not None:
            frames.add(entry.frame_id)
        if len(frames) == 1:
            stamps.append((frames.pop(), entry.timestamp))
        else:
            reason = "there is neither a frame_id nor a file name with a frame number"
            if frames:
                reason = "frame_id and file names are of different frames"
            value = entry.timestamp if entry.frame_id is None else (entry.frame_id, *names)
            problems.add("record", reason, frame=path.name, field="frame_id", value=value)
    stamps.sort()
    frame = np.array([frame for frame, _ in stamps], np.int64)
    seconds = np.array([second for _, second in stamps], np.float64)
    if not ((np.diff(frame) > 0) & (np.diff(seconds) > 0)).all():
        raise InputError(f"{path.name}: timestamps do not increase with the frames", file=path.name)
    return frame, seconds
