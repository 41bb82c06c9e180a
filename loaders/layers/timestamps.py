"""When frames were taken: `timestamps/<sequence>/frames_img.json` and `frames_pc.json` -> the table `timestamps`.

Seconds since the epoch, one stamp per frame and sensor, strictly increasing with the frames. An entry's frame is its
`frame_id`, or the base name that its pictures or clouds have, or both where they agree; an entry that contradicts
itself or the order of the others is refused.
"""

from __future__ import annotations

import codecs
import os
import re
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records as fields
from jrdb_avr.loaders.labelfiles.columns import constant
from jrdb_avr.loaders.labelfiles.frames import read_file
from jrdb_avr.loaders.labelfiles.jsonscan import MalformedError, elements, end_of_text, members
from jrdb_avr.loaders.labelfiles.records import record_parts
from jrdb_avr.loaders.layers.layer import Reading
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS

MAX_ENTRIES: Final = 100_000
MAX_FRAME: Final = 999_999
MAX_SECONDS: Final = 1e11
"""A larger stamp counts something other than seconds since the epoch."""


class Sensor(NamedTuple):
    """One of the two files: what it stamps, its name, the key of its lists of files, and how those names end."""

    name: str
    file: str
    key: str
    suffixes: str


SENSORS: Final = (
    Sensor("clouds", "frames_pc.json", "pointclouds", "pcd|pcb|bin"),
    Sensor("images", "frames_img.json", "cameras", "jpg|jpeg|png"),
)
"""By name, as the table is sorted."""


class _Picture(msgspec.Struct, gc=False):
    url: str | None = None
    timestamp: float | str | None = None


class _Entry(msgspec.Struct, gc=False):
    frame_id: int | str | None = None
    timestamp: float | str | None = None
    cameras: list[_Picture] | None = None
    pointclouds: list[_Picture] | None = None


class _File(msgspec.Struct, gc=False):
    data: list[_Entry]


class _Stamp(NamedTuple):
    frame: int
    seconds: float


def load_timestamps(folder: Path, sequence: str, problems: Problems) -> Reading:
    """Read what there is of the two files; one that cannot be used does not cost the other.

    Raises InputError where the folder holds neither of them or neither can be used.
    """
    found: dict[str, list[_Stamp]] = {}
    errors = []
    for sensor in SENSORS:
        path = folder / sensor.file
        try:
            if os.path.lexists(path):
                found[sensor.name] = _increasing(_stamps(path, sensor, problems), sensor, problems)
        except InputError as error:
            errors.append(error)
        except OSError as error:
            errors.append(InputError(f"{sensor.file}: cannot be read: {error.strerror}", file=sensor.file))
    if not found:
        raise errors[0] if errors else InputError("there is neither frames_img.json nor frames_pc.json")
    for unusable in errors:
        problems.add("file", str(unusable))
    names = [name for name, stamps in found.items() for _ in stamps]
    frame = np.array([stamp.frame for stamps in found.values() for stamp in stamps], np.int64)
    table = pa.table(
        {
            "sequence": constant(sequence, len(names)),
            "sensor": pa.array(names, pa.string()),
            "frame": frame,
            "timestamp": pa.array([stamp.seconds for stamps in found.values() for stamp in stamps], pa.float64()),
        }
    ).cast(ANNOTATIONS["timestamps"])
    known, records = np.unique(frame, return_counts=True)
    return Reading({"timestamps": table}, {"timestamps": (known, records)})


def frame_rate(frame: Ints, seconds: Sequence[float]) -> float | None:
    """Frames per second of stamps in order of frames: the median over neighbours; None for fewer than two."""
    if len(frame) < 2:
        return None
    return float(np.median(np.diff(frame) / np.diff(np.asarray(seconds, np.float64))))


def _stamps(path: Path, sensor: Sensor, problems: Problems) -> list[_Stamp]:
    """The stamp of each usable entry, in the order of the file."""
    data = read_file(path).removeprefix(codecs.BOM_UTF8)
    name_form = re.compile(rf"([0-9]{{6}})\.(?:{sensor.suffixes})")
    stamps = []
    for place, entry in _entries(data, sensor, problems):
        try:
            frame = _frame(entry, sensor, name_form)
        except ValueError as error:
            problems.add("record", str(error), frame=place, field="frame_id", value=entry.frame_id)
            continue
        try:
            stamps.append(_Stamp(frame, _seconds(entry.timestamp)))
        except ValueError as error:
            problems.add("record", f"timestamp: {error}", frame=place, field="timestamp", value=entry.timestamp)
    return stamps


def _frame(entry: _Entry, sensor: Sensor, name_form: re.Pattern[str]) -> int:
    """The one frame that all of an entry agrees on. Raises ValueError."""
    frames = set()
    if entry.frame_id is not None:
        try:
            frames.add(fields.whole(entry.frame_id, 0, MAX_FRAME))
        except ValueError as error:
            raise ValueError(f"frame_id: {error}") from None
    for picture in getattr(entry, sensor.key) or ():
        match = name_form.fullmatch((picture.url or "").rpartition("/")[2])
        if match:
            frames.add(int(match[1]))
    if len(frames) > 1:
        raise ValueError("frame_id and the names of files do not agree")
    if not frames:
        raise ValueError("neither a frame_id nor a file named after a frame")
    return frames.pop()


def _seconds(value: object) -> float:
    """A stamp, also as text. Raises ValueError."""
    if isinstance(value, str) and re.fullmatch(r"[0-9]{1,11}(\.[0-9]{1,20})?", value):
        value = float(value)
    seconds = fields.number(value)
    if not 0 <= seconds <= MAX_SECONDS:
        raise ValueError("no seconds since the epoch")
    return seconds


def _increasing(stamps: list[_Stamp], sensor: Sensor, problems: Problems) -> list[_Stamp]:
    """The first stamp of each frame, and of those the longest part that increases; by frame."""
    first: dict[int, _Stamp] = {}
    for stamp in stamps:
        if stamp.frame in first:
            _refuse(stamp, "frame twice, the first is kept", sensor, problems)
        else:
            first[stamp.frame] = stamp
    ordered = sorted(first.values())
    kept = set(_longest_increasing([stamp.seconds for stamp in ordered]))
    for i, stamp in enumerate(ordered):
        if i not in kept:
            _refuse(stamp, "timestamp does not increase with the frames", sensor, problems)
    return [stamp for i, stamp in enumerate(ordered) if i in kept]


def _refuse(stamp: _Stamp, reason: str, sensor: Sensor, problems: Problems) -> None:
    suffix = sensor.suffixes.split("|")[0]
    problems.add("record", reason, frame=f"{stamp.frame:06d}.{suffix}", field="timestamp", value=stamp.seconds)


def _longest_increasing(values: list[float]) -> list[int]:
    """Positions of a longest strictly increasing subsequence, of several the earliest: a stray stamp costs itself."""
    tails: list[float] = []
    lengths = []
    for value in reversed(values):
        # Length of the longest increasing subsequence that begins here; `tails` holds negated values.
        place = bisect_left(tails, -value)
        tails[place : place + 1] = [-value]
        lengths.append(place + 1)
    lengths.reverse()
    chain: list[int] = []
    wanted = len(tails)
    for i, value in enumerate(values):
        if lengths[i] == wanted and (not chain or value > values[chain[-1]]):
            chain.append(i)
            wanted -= 1
    return chain


# -- entries -----------------------------------------------------------------------------------------------------


def _entries(data: bytes, sensor: Sensor, problems: Problems) -> Iterator[tuple[str, _Entry]]:
    """The entries of a file, each with its place. Raises InputError where it is no JSON or endless."""
    try:
        entries = msgspec.json.decode(data, type=_File).data
    except (msgspec.DecodeError, RecursionError, UnicodeError):
        entries = None
    # Of a repeated key, decoding keeps the last only: then the text holds more keys than were read.
    if entries is None or not _whole(data, entries) or len(entries) > MAX_ENTRIES:
        yield from _scanned(data, sensor, problems)
    else:
        for i, entry in enumerate(entries):
            yield _place(sensor, i), entry


def _whole(data: bytes, entries: list[_Entry]) -> bool:
    pictures = [
        picture for entry in entries for listed in (entry.cameras, entry.pointclouds) if listed for picture in listed
    ]
    read = {
        "data": 1,
        "frame_id": sum(entry.frame_id is not None for entry in entries),
        "timestamp": sum(entry.timestamp is not None for entry in entries)
        + sum(picture.timestamp is not None for picture in pictures),
        "url": sum(picture.url is not None for picture in pictures),
        "cameras": sum(entry.cameras is not None for entry in entries),
        "pointclouds": sum(entry.pointclouds is not None for entry in entries),
    }
    return all(data.count(f'"{key}"'.encode()) == count for key, count in read.items())


def _scanned(data: bytes, sensor: Sensor, problems: Problems) -> Iterator[tuple[str, _Entry]]:
    """Entries of a file that is not clean, each judged alone."""
    try:
        found, last = [], 0
        for key, begin, end in members(data):
            last = end
            if key == b'"data"':
                found.append(data[begin:end])
        if not end_of_text(data, last):
            raise InputError(f"{sensor.file}: not JSON: there is text after its end", file=sensor.file)
        if not found or not found[0].startswith(b"["):
            raise InputError(f'{sensor.file}: there is no list "data"', file=sensor.file)
        if len(found) > 1:
            problems.add("file", "key twice, the first is kept", field="data", count=len(found) - 1)
        for i, (begin, end) in enumerate(elements(found[0])):
            if i == MAX_ENTRIES:
                raise InputError(f"{sensor.file}: more than {MAX_ENTRIES} entries", file=sensor.file)
            place = _place(sensor, i)
            parts = record_parts(found[0][begin:end], place, problems)
            if parts is not None:
                yield place, _repaired(parts, sensor, place, problems)
    except MalformedError as error:
        raise InputError(f"{sensor.file}: not JSON: {error}", file=sensor.file) from None


def _repaired(parts: dict[str, bytes], sensor: Sensor, place: str, problems: Problems) -> _Entry:
    """An entry whose values may be anything; a list of files that is none is refused."""
    entry = _Entry(*(_loose(parts.get(name)) for name in ("frame_id", "timestamp")))
    raw = parts.get(sensor.key, b"null")
    if raw == b"null":
        return entry
    pictures = []
    try:
        for begin, end in elements(raw):
            inner = record_parts(raw[begin:end], place, problems)
            if inner is not None:
                url = _loose(inner.get("url"))
                pictures.append(_Picture(url if isinstance(url, str) else None))
    except MalformedError as error:
        problems.add("field", str(error), frame=place, field=sensor.key, value=raw)
    setattr(entry, sensor.key, pictures)
    return entry


def _loose(raw: bytes | None) -> Any:
    """A JSON value; what is no JSON stays bytes, which every field's check refuses (as text, 01 would be a number)."""
    try:
        return None if raw is None else fields.loose(raw)
    except ValueError:
        return raw or None


def _place(sensor: Sensor, i: int) -> str:
    return f"{sensor.file}, entry {i}"
