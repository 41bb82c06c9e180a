"""When frames were taken: `timestamps/<sequence>/frames_img.json` and `frames_pc.json` -> the table `timestamps`.

Seconds since the epoch, one stamp per frame and sensor, strictly increasing with the frames. An entry's frame is its
`frame_id`, or the base name that its pictures or clouds have, or both where they agree; an entry that contradicts
itself or the order of the others is refused.
"""

from __future__ import annotations

import os
import re
from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise, repeat
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.columns import LayerTables, whole_numbers
from jrdb_avr.loaders.labelfiles.frames import read_file
from jrdb_avr.loaders.labelfiles.json import BROKEN, MalformedError, Members, elements, first_members, members, parse
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS

_MAX_ENTRIES: Final = 100_000
_MAX_BYTES: Final = 32 << 20
"""Thirty times the real files."""
_MAX_FRAME: Final = 999_999
MAX_SECONDS: Final = 1e11
"""A larger stamp counts something other than seconds since the epoch."""
DEPTH: Final = 5
"""Objects and lists around the innermost value of a file."""


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


class Stamp(NamedTuple):
    """When a frame was taken."""

    frame: int
    seconds: float


class _File(msgspec.Struct, gc=False):
    """A picture or cloud of an entry."""

    name: str
    url: str
    timestamp: float


_Frame = Annotated[int, msgspec.Meta(ge=0, le=_MAX_FRAME)]
_Seconds = Annotated[float, msgspec.Meta(ge=0, le=MAX_SECONDS)]
_MEMBERS: Final = [("frame_id", _Frame), ("timestamp", _Seconds), ("files", list[_File])]


def _decoder(key: str) -> msgspec.json.Decoder[dict[str, list[Any]]]:
    """A decoder of files that are laid out as usual, with the key of their lists of files."""
    entry = msgspec.defstruct("Entry", _MEMBERS, rename={"files": key}, gc=False)
    return msgspec.json.Decoder(dict[Literal["data"], list[entry]])  # type: ignore[valid-type]


_USUAL: Final = {sensor: _decoder(sensor.key) for sensor in SENSORS}


def load_timestamps(folder: Path, problems: Problems) -> LayerTables:
    """Read what there is of the two files; one that cannot be used does not cost the other.

    Raises InputError where the folder holds neither of them or neither can be used.
    """
    found: dict[str, list[Stamp]] = {}
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
    schema = ANNOTATIONS["timestamps"].remove(0)
    rows = [(name, *stamp) for name, stamps in found.items() for stamp in stamps]
    columns = zip(*rows, strict=True) if rows else repeat(())
    table = pa.Table.from_pydict(dict(zip(schema.names, columns, strict=False)), schema)
    known = np.unique(whole_numbers(table, "frame"), return_counts=True)
    return LayerTables({"timestamps": table}, {"timestamps": known})


def frame_rate(frame: Ints, seconds: Sequence[float]) -> float | None:
    """Frames per second of stamps in order of frames: the median over neighbours; None for fewer than two."""
    if len(frame) < 2:
        return None
    return float(np.median(np.diff(frame) / np.diff(np.asarray(seconds, np.float64))))


def _stamps(path: Path, sensor: Sensor, problems: Problems) -> list[Stamp]:
    """The stamp of each usable entry, in the order of the file. Raises InputError where it is no JSON or endless."""
    data = read_file(path)
    if len(data) > _MAX_BYTES:
        raise InputError(f"{sensor.file}: larger than the limit of {_MAX_BYTES >> 20} MB", file=sensor.file)
    if (usual := _usual_stamps(data, sensor)) is not None:
        return usual
    try:
        top, again = first_members(_tree(data.strip(b" \t\r\n")))
    except ValueError as error:
        raise InputError(f"{sensor.file}: not JSON: {error}", file=sensor.file) from None
    entries = top.get("data")
    if not isinstance(entries, list):
        raise InputError(f'{sensor.file}: there is no list "data"', file=sensor.file)
    if "data" in again:
        problems.add("file", records.TWICE, field="data", count=again.count("data"))
    if len(entries) > _MAX_ENTRIES:
        raise InputError(f"{sensor.file}: more than {_MAX_ENTRIES} entries", file=sensor.file)
    stamps = []
    for i, entry in enumerate(entries):
        place = f"{sensor.file}, entry {i}"
        values = _members(entry, place, problems)
        if values is None:
            continue
        field, reason = "frame_id", ""
        try:
            frame = _frame(values.get("frame_id"), _file_names(values.get(sensor.key), sensor, place, problems), sensor)
            field, reason = "timestamp", "timestamp: "
            stamps.append(Stamp(frame, _seconds(values.get("timestamp"))))
        except ValueError as error:
            problems.add("record", f"{reason}{error}", frame=place, field=field, value=values.get(field))
    return stamps


def _usual_stamps(data: bytes, sensor: Sensor) -> list[Stamp] | None:
    """The stamps of a file in the usual layout, whose pictures are named as their frames; None for any other file."""
    try:
        entries = _USUAL[sensor].decode(data).get("data", [])
    except BROKEN:
        return None
    names = [(f"{entry.frame_id:06d}", [file.url for file in entry.files]) for entry in entries]
    # A colon for each key and no other: none is repeated.
    keys = 1 + 3 * len(entries) + 3 * sum(len(urls) for _, urls in names)
    if len(entries) > _MAX_ENTRIES or data.count(b":") != keys:
        return None
    if not all(url.rpartition("/")[2].startswith(f"{name}.") for name, urls in names for url in urls):
        return None
    return [Stamp(entry.frame_id, entry.timestamp) for entry in entries]


def _tree(raw: bytes | memoryview, depth: int = DEPTH) -> Any:
    """A parsed value; a part that is no JSON is its bytes, which the check of every field refuses.

    Raises MalformedError where the structure breaks outside the entries.
    """
    try:
        return parse(raw)
    except ValueError:
        first = bytes(raw[:1]) if depth else b""
    try:
        if first == b"[":
            return [_tree(value, depth - 1) for value in elements(raw)]
        if first == b"{":
            return Members([(key, _tree(value, depth - 1)) for key, value in members(raw, strict=True)])
    except MalformedError:
        if depth >= DEPTH - 1:
            raise
    return bytes(raw)


def _members(value: object, place: str, problems: Problems) -> dict[str, Any] | None:
    """The members of an object, first of equal keys; None, counted, for anything else."""
    try:
        found, again = first_members(value)
    except ValueError:
        problems.add("record", "record is no object", frame=place, value=value)
        return None
    for key in again:
        problems.add("field", records.TWICE, frame=place, field=shorten(key))
    return found


def _file_names(files: object, sensor: Sensor, place: str, problems: Problems) -> list[str]:
    """The base names of an entry's files."""
    if files is not None and not isinstance(files, list):
        problems.add("field", "not a list", frame=place, field=sensor.key, value=files)
        return []
    urls = [(_members(file, place, problems) or {}).get("url") for file in files or ()]
    return [url.rpartition("/")[2] for url in urls if isinstance(url, str)]


def _frame(frame_id: object, names: list[str], sensor: Sensor) -> int:
    """The one frame on which an entry and the names of its files agree. Raises ValueError."""
    form = re.compile(rf"([0-9]{{6}})\.(?:{sensor.suffixes})")
    frames = {int(match[1]) for match in map(form.fullmatch, names) if match}
    if frame_id is not None:
        try:
            frames.add(records.whole(frame_id, 0, _MAX_FRAME))
        except ValueError as error:
            raise ValueError(f"frame_id: {error}") from None
    if len(frames) > 1:
        raise ValueError("frame_id and the names of files do not agree")
    if not frames:
        raise ValueError("neither a frame_id nor a file named after a frame")
    return frames.pop()


def _seconds(value: object) -> float:
    """A stamp, also as text. Raises ValueError."""
    if isinstance(value, str) and re.fullmatch(r"[0-9]{1,11}(\.[0-9]{1,20})?", value):
        value = float(value)
    seconds = records.number(value)
    if not 0 <= seconds <= MAX_SECONDS:
        raise ValueError("no seconds since the epoch")
    return seconds


def _increasing(stamps: list[Stamp], sensor: Sensor, problems: Problems) -> list[Stamp]:
    """The first stamp of each frame, and of those the longest part that increases; by frame."""
    if all(one.frame < later.frame and one.seconds < later.seconds for one, later in pairwise(stamps)):
        return stamps
    first: dict[int, Stamp] = {}
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


def _refuse(stamp: Stamp, reason: str, sensor: Sensor, problems: Problems) -> None:
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
