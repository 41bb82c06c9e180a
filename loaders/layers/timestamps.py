"""Times of frames: `timestamps/<sequence>/frames_img.json` and `frames_pc.json` -> the table `timestamps`.

Seconds since the epoch, one stamp per frame and sensor, strictly increasing with the frames. The frame of an entry is
its `frame_id`, or the base name of its images or clouds, or both if they agree. An entry that contradicts itself is
refused. A file with stamps that do not increase with the frames is refused as a whole.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles.columns import LayerTables, constant
from jrdb_avr.loaders.labelfiles.frames import RecordReader, decode_file
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Floats, Ints
from jrdb_avr.schema.errors import InputError

_MAX_ENTRIES: Final = 100_000
MAX_SECONDS: Final = 1e11
"""Maximum stamp. A larger number does not count seconds since the epoch."""


class Sensor(NamedTuple):
    """One of the two files: its sensor, its name, and the suffixes of the files that it lists."""

    name: str
    file: str
    suffixes: str


SENSORS: Final = (
    Sensor("clouds", "frames_pc.json", "pcd|pcb|bin"),
    Sensor("images", "frames_img.json", "jpg|jpeg|png"),
)
"""Sorted by name, as the table is."""


class _Listed(msgspec.Struct, gc=False):
    url: str | None = None


class StampedFrame(msgspec.Struct, gc=False):
    """One frame of a file, with its images or clouds."""

    timestamp: Annotated[float, msgspec.Meta(ge=0, le=MAX_SECONDS)]
    frame_id: Annotated[int, msgspec.Meta(ge=0, le=999_999)] | None = None
    cameras: list[_Listed] | None = None
    pointclouds: list[_Listed] | None = None


class _File(msgspec.Struct):
    data: msgspec.Raw


_READER: Final = RecordReader(StampedFrame)


def load_timestamps(folder: Path, problems: Problems) -> LayerTables:
    """Read the two files of a sequence. An unusable file does not cost the other.

    Raises:
        InputError: the folder has neither file, or neither is usable.
    """
    columns: dict[str, tuple[Ints, Floats]] = {}
    errors = []
    for sensor in SENSORS:
        try:
            if os.path.lexists(folder / sensor.file):
                columns[sensor.name] = _stamps(folder / sensor.file, sensor, problems)
        except InputError as error:
            errors.append(error)
        except OSError as error:
            errors.append(InputError(f"{sensor.file}: cannot be read: {error.strerror}", file=sensor.file))
    if not columns:
        raise errors[0] if errors else InputError("there is neither frames_img.json nor frames_pc.json")
    for unusable in errors:
        problems.add("file", str(unusable))
    table = pa.concat_tables(
        pa.table({"sensor": constant(name, len(frame)), "frame": frame, "timestamp": seconds})
        for name, (frame, seconds) in columns.items()
    )
    frames = np.unique(np.concatenate([frame for frame, _ in columns.values()]), return_counts=True)
    return LayerTables({"timestamps": table}, {"timestamps": frames})


def frame_rate(frame: Ints, seconds: Sequence[float]) -> float | None:
    """Return the median frames per second over neighbouring stamps in order of frames, or None for fewer than two."""
    if len(frame) < 2:
        return None
    return float(np.median(np.diff(frame) / np.diff(np.asarray(seconds, np.float64))))


def _stamps(path: Path, sensor: Sensor, problems: Problems) -> tuple[Ints, Floats]:
    """Return the frames, ascending, and the stamps of the usable entries."""
    try:
        entries, _ = _READER.read(decode_file(path, _File).data, problems, lambda raw: sensor.file)
    except msgspec.DecodeError:
        raise InputError(f'{sensor.file}: there is no list "data"', file=sensor.file) from None
    if len(entries) > _MAX_ENTRIES:
        raise InputError(f"{sensor.file}: more than {_MAX_ENTRIES} entries", file=sensor.file)
    stamps: list[tuple[int, float]] = []
    form = re.compile(rf"([0-9]{{6}})\.(?:{sensor.suffixes})")
    for entry in entries:
        names = [(listed.url or "").rpartition("/")[2] for listed in entry.cameras or entry.pointclouds or ()]
        frames = {int(match[1]) for match in map(form.fullmatch, names) if match}
        if entry.frame_id is not None:
            frames.add(entry.frame_id)
        if len(frames) == 1:
            stamps.append((frames.pop(), entry.timestamp))
        else:
            reason = "neither a frame_id nor a file named after a frame"
            if frames:
                reason = "frame_id and the names of files do not agree"
            problems.add("record", reason, frame=sensor.file, field="frame_id", value=_shown(entry, names))
    stamps.sort()
    frame = np.array([frame for frame, _ in stamps], np.int64)
    seconds = np.array([second for _, second in stamps], np.float64)
    if not ((np.diff(frame) > 0) & (np.diff(seconds) > 0)).all():
        raise InputError(f"{sensor.file}: timestamps do not increase with the frames", file=sensor.file)
    return frame, seconds


def _shown(entry: StampedFrame, names: list[str]) -> Any:
    return entry.timestamp if entry.frame_id is None else (entry.frame_id, *names)
