"""Reader that turns label files `{"labels": {"<frame>.<suffix>": [record, ...]}}` into columns.

msgspec splits a file into frames and decodes each frame into typed records. If a frame cannot be decoded, its records
are decoded one by one, and only the records that fail are refused. Because decoded records take much memory, they are
turned into columns after every `BATCH` records.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import os
import re
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import msgspec
import numpy as np

from jrdb_avr.loaders.labelfiles.columns import Columns, Distinct, numbered
from jrdb_avr.loaders.labelfiles.records import BROKEN, parse, read_flag
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.errors import InputError

MAX_FILE: Final = 320 << 20
"""Maximum bytes of a file. The largest file of JRDB has half as many."""
MAX_FRAME: Final = 4 << 20
"""Maximum bytes of a frame, about 4 kB for each of `MAX_RECORDS` records. A larger frame is not decoded."""
MAX_RECORDS: Final = 1000
"""Maximum records of a frame, which bounds the number of pairs of people. JRDB's fullest frames have about 100."""
MAX_GATHERED: Final = 400_000
"""Maximum records of a file. JRDB's largest sequence has half as many boxes."""
BATCH: Final = 1000
"""Number of records that are turned into columns together. A batch fits into the processor's cache."""

LENIENT: Final = frozenset(("file_id", "attributes.truncated", "attributes.interpolated", "attributes.no_eval"))
"""Fields that may have an unusable value. All other unusable values cause the refusal of the record."""
_LIST: Final = msgspec.json.Decoder(list[msgspec.Raw])
_MEMBERS: Final = msgspec.json.Decoder(dict[str, msgspec.Raw])
_MISSING: Final = re.compile("Object missing required field `(.*)`")

_R = TypeVar("_R", bound=msgspec.Struct)
_F = TypeVar("_F", bound=msgspec.Struct)

Fields = dict[str, tuple[Any, ...]]
"""Values of a batch of records, by name of the field. Each tuple holds one value per record."""


Naming = Callable[[msgspec.Raw], str]
"""Function that takes a raw record and returns the record's name for the report."""


class FrameKey(str):
    """Key of a frame. msgspec does not know this type, so that it calls a hook with every key of a file.

    The hook finds repeated keys.
    """

    __slots__ = ()


class LabelFile(msgspec.Struct):
    """Content of a whole label file: for each frame, the raw list of the frame's records, by the key of the frame."""

    labels: dict[FrameKey, msgspec.Raw]


def read_file(path: Path) -> bytes:
    """Return the content of a file. If it begins with a byte order mark, the mark is removed.

    Raises:
        InputError: If the path is not a regular file, or if the file is too large, unreadable or empty.
    """
    name = path.name
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{name}: not a file", file=name)
        if status.st_size > MAX_FILE:
            size = f"{status.st_size / (1 << 20):.0f} MB"
            raise InputError(f"{name}: {size}, larger than the limit of {MAX_FILE >> 20} MB", file=name)
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {os.strerror(error.errno or errno.EIO)}", file=name) from None
    if not data or data.isspace():
        raise InputError(f"{name}: the file is empty", file=name)
    return data.removeprefix(codecs.BOM_UTF8)


def decode_file(path: Path, form: type[_F], hook: Callable[[type, Any], Any] | None = None) -> _F:
    """Decode a JSON file into an object of the type `form`.

    Args:
        path: JSON file.
        form: type of the result.
        hook: function for types that msgspec does not know. It is called with such a type and a value, and returns the
            value converted to this type.

    Raises:
        InputError: If the file is unreadable, is not JSON, or does not fit the type `form`.
    """
    data = read_file(path)
    try:
        if not data.isascii():
            # msgspec does not check whether raw values are UTF-8.
            data.decode()
        return msgspec.json.decode(data, type=form, dec_hook=hook)
    except msgspec.ValidationError as error:
        raise InputError(f"{path.name}: {error}".replace("`", ""), file=path.name) from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path.name}: not UTF-8 at byte {error.start}", file=path.name) from None
    except BROKEN as error:
        raise InputError(f"{path.name}: not JSON: {error}", file=path.name) from None


class RecordReader(Generic[_R]):
    """Decoder of JSON lists of records. It refuses records that do not fit the type `record`, and keeps the rest."""

    def __init__(self, record: type[_R]) -> None:
        self.type = record
        self._all = msgspec.json.Decoder(list[record])  # type: ignore[valid-type]
        self._one = msgspec.json.Decoder(record)

    def read(
        self, raw: bytes | msgspec.Raw, problems: Problems, name: Naming, limit: int = MAX_GATHERED
    ) -> tuple[list[_R], int]:
        """Decode a list of records.

        Args:
            raw: JSON list.
            problems: counter of refused records.
            name: function that is called with each refused raw record, and returns its name for the report.
            limit: maximum number of records in a list that has a faulty record. If such a list is longer, all its
                records are refused, and none of them is reported.

        Returns:
            The usable records, and the number of refused records.

        Raises:
            msgspec.DecodeError: If `raw` is not a list.
        """
        try:
            return self._all.decode(raw), 0
        except BROKEN:
            raws, records = _LIST.decode(raw), []
        if len(raws) > limit:
            return [], len(raws)
        for record in raws:
            try:
                records.append(self._decode(record, problems, name))
            except BROKEN as error:
                reason, field = fault_of(error)
                problems.add("record", reason, frame=name(record), field=field, value=bytes(record))
        return records, len(raws) - len(records)

    def _decode(self, raw: msgspec.Raw, problems: Problems, name: Naming) -> _R:
        """Decode a record. Unusable values of the fields in `LENIENT` are replaced by null and counted as problems.

        The texts "true" and "false" in an attribute are replaced by the bool, and are not counted.
        """
        try:
            return self._one.decode(raw)
        except BROKEN as error:
            reason, field = fault_of(error)
            if field not in LENIENT:
                raise
        *outer, member = field.split(".")
        record = _MEMBERS.decode(raw)
        inner = _MEMBERS.decode(record[outer[0]]) if outer else record
        usable = None
        with contextlib.suppress(ValueError):
            usable = read_flag(parse(inner[member])) if outer else None
        if usable is None:
            problems.add("field", reason, frame=name(raw), field=field, value=bytes(inner[member]))
            # A person who is excluded from the evaluation is not in clear view. If `no_eval` is unusable, a clear view
            # is therefore not certain, and the occlusion becomes unknown too.
            inner |= {"occlusion": msgspec.Raw(b"null")} if member == "no_eval" else {}
        inner[member] = msgspec.Raw(msgspec.json.encode(usable))
        if outer:
            record[outer[0]] = msgspec.Raw(msgspec.json.encode(inner))
        return self._decode(msgspec.Raw(msgspec.json.encode(record)), problems, name)

    def fields(self, records: list[_R]) -> Fields:
        """Return the values of each field, by name of the field. The tuple of a field has one value per record."""
        columns = zip(*map(msgspec.structs.astuple, records), strict=True) if records else ((),) * 99
        return dict(zip(self.type.__struct_fields__, columns, strict=False))


def fault_of(error: BaseException) -> tuple[str, str]:
    """Return the reason of a decoding error, and the name of the field that could not be decoded.

    The name is "" if the error does not name a field.
    """
    reason, _, path = str(error).partition(" - at `$")
    field = path.split("[")[0].strip(".`")
    if missing := _MISSING.fullmatch(reason):
        return f"{missing[1]} is missing", f"{field}.{missing[1]}".strip(".")
    return reason.replace("`", ""), field


def gather(
    path: Path,
    suffixes: tuple[str, ...],
    reader: RecordReader[_R],
    take: Callable[[Fields], Columns],
    problems: Problems,
) -> tuple[Columns, list[int], list[int]]:
    """Read a label file into columns.

    Args:
        path: label file.
        suffixes: permitted suffixes of frame keys, such as "jpg".
        reader: decoder of the records.
        take: function that is called with the fields of each batch of records, and returns their columns.
        problems: counter of refused frames and records.

    Returns:
        The column `frame` and the columns from `take`, of all usable records in the order of the file; the frames with
        a usable list of records, which may be empty; and the frames of these without a refused record.

    Raises:
        InputError: If the file as a whole cannot be used.
    """
    listed: list[int] = []
    complete: list[int] = []
    counts: list[int] = []
    total = 0
    batch: list[_R] = []
    parts: list[Columns] = []
    for key, frame, raw in _frames(path, suffixes, problems):
        if len(raw) > MAX_FRAME:
            problems.add("frame", f"frame with more than {MAX_FRAME >> 20} MB", frame=key)
            continue
        try:
            records, refused = reader.read(raw, problems, lambda _, key=key: key, MAX_RECORDS)  # type: ignore[misc]
        except BROKEN as error:
            problems.add("frame", "frame is not a list of records", frame=key, value=str(error))
            continue
        total += len(records) + refused
        if total > MAX_GATHERED:
            raise InputError(f"{path.name}: more than {MAX_GATHERED:,} records", file=path.name)
        if len(records) + refused > MAX_RECORDS:
            problems.add("frame", f"frame with more than {MAX_RECORDS} records", frame=key)
            continue
        listed.append(frame)
        counts.append(len(records))
        if not refused:
            complete.append(frame)
        batch += records
        if len(batch) >= BATCH:
            parts.append(take(reader.fields(batch)))
            batch = []
    parts.append(take(reader.fields(batch)))
    columns = {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}
    return {"frame": np.repeat(np.array(listed, np.int64), counts), **columns}, listed, complete


def _frames(path: Path, suffixes: tuple[str, ...], problems: Problems) -> Iterator[tuple[str, int, msgspec.Raw]]:
    """Yield the key, the index and the raw list of records of each frame with a usable key.

    All other frames are counted as problems.
    """
    form = re.compile(r"([0-9]{6})\.(?:" + "|".join(suffixes) + ")")
    listed: set[int] = set()
    keys: set[str] = set()

    def take(_: type, key: str) -> FrameKey:
        """Convert a key of the JSON object of frames to a `FrameKey`.

        Raise ValueError if the key occurs twice, because the decoder would then keep only the last list of records.
        """
        if key in keys:
            raise ValueError(f"the frame {shorten(key)} is listed twice")
        keys.add(key)
        return FrameKey(key)

    labels = decode_file(path, LabelFile, take).labels
    if len(labels) != len(keys):
        raise InputError(f"{path.name}: the key labels is repeated", file=path.name)
    if not labels:
        raise InputError(f"{path.name}: labels has no frames", file=path.name)
    for key, raw in labels.items():
        match = form.fullmatch(key)
        if match is None:
            problems.add("frame", "frame key is not six digits with suffix " + "/".join(suffixes), frame=shorten(key))
        elif int(match[1]) in listed:
            problems.add("frame", "frame key is repeated, the first is kept", frame=key)
        else:
            listed.add(int(match[1]))
            yield key, int(match[1]), raw


def take_fields(fields: Fields, names: tuple[str, ...], codes: dict[str, Distinct]) -> Columns:
    """Replace the values of fields by codes. Return one column of codes for each field in `names`.

    Args:
        fields: values of the fields of a batch of records, by name of the field.
        names: names of the fields to replace. Two raw values are equal if they have the same bytes.
        codes: codes of the distinct values of each field, by name of the field. New values are added.
    """
    columns = {}
    for name in names:
        values = fields[name]
        raw = bool(values) and isinstance(values[0], msgspec.Raw)
        columns[name] = numbered(codes[name], map(bytes, values) if raw else values, len(values))
    return columns
