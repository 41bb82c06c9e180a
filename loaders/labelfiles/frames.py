"""A JRDB label file, `{"labels": {"<frame>.<suffix>": [record, ...]}}`, read frame by frame.

The outer level is cut into raw frames first and each frame is decoded alone: memory stays small, and what is broken
stays in its own frame or record. A file that cannot be used as a whole raises InputError.
"""

from __future__ import annotations

import codecs
import errno
import os
import re
import stat
from collections.abc import Callable, Iterator, Sequence
from itertools import chain, islice, repeat
from operator import attrgetter, is_not
from pathlib import Path
from typing import Any, Final, Generic, NamedTuple, TypeVar

import msgspec

from jrdb_avr.loaders.labelfiles.json import OtherLayoutError, frame_texts
from jrdb_avr.loaders.labelfiles.jsonscan import MalformedError, elements, end_of_text, members
from jrdb_avr.loaders.labelfiles.keys import WrittenKeys
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.errors import InputError

MAX_FILE: Final = 160 << 20
"""Bytes of the largest file that is read into memory as a whole."""
MAX_FRAMED: Final = 512 << 20
"""Bytes of the largest file of frames: where these are laid out as usual, only one at a time is in memory."""
_PIECE: Final = 1 << 20
MAX_FRAME: Final = 4 << 20
MAX_RECORDS: Final = 1000
"""Records of one frame: JRDB's fullest have about a hundred, and pairs of people grow with the square."""
SCAN_FROM: Final = 64 << 20
"""Lists of this many bytes or more are cut by the scanner, whose memory does not depend on the number of members."""

R = TypeVar("R", bound=msgspec.Struct)

BROKEN: Final = (msgspec.DecodeError, RecursionError, UnicodeError)


class RecordReader(Generic[R]):
    """Decodes records of type R: whole frames at once where they are clean, else one by one.

    `repair` gets the bytes of a record that is not clean, the frame key and the problems, and returns what can be used
    of it or None. `once` names the fields that a record has at most once, fields of one meaning together: where a frame
    holds their keys more often than decoded records have them, a record repeats one (JSON leaves open which of the two
    counts), and the frame is taken record by record. `clean` looks deeper into decoded records and their keys.
    """

    def __init__(
        self,
        record: type[R],
        repair: Callable[[bytes, str, Problems], R | None],
        once: tuple[str | tuple[str, ...], ...],
        clean: Callable[[list[R], WrittenKeys], bool] = lambda records, written: True,
    ) -> None:
        self._frame = msgspec.json.Decoder(list[record])  # type: ignore[valid-type]
        self._record = msgspec.json.Decoder(record)
        self._repair = repair
        info = {field.name: field for field in msgspec.structs.fields(record)}
        groups = [[info[name] for name in ((group,) if isinstance(group, str) else group)] for group in once]
        self._once = [([f'"{field.encode_name}"'.encode() for field in group], group) for group in groups]
        self._clean = clean

    def decode(self, raw: bytes) -> list[R] | None:
        """The records of a frame, if all are of the form expected. Decoding may have lost repeated keys."""
        try:
            return self._frame.decode(raw)
        except BROKEN:
            return None

    def read_frames(
        self, frames: Sequence[Frame], problems: Problems
    ) -> Iterator[tuple[Frame, tuple[list[R], bool] | None]]:
        """As `read`, of frames as `read_frames` cuts them by means of `decode`: beside each what is read of it."""
        # Looking for repeated keys in few long texts takes half the time of looking in many short ones.
        decoded = [frame for frame in frames if frame.records is not None and len(frame.records) <= MAX_RECORDS]
        records = list(chain.from_iterable(frame.records or () for frame in decoded))
        plain = {frame.number for frame in decoded} if self.plain(records, b",".join(f.raw for f in decoded)) else ()
        for frame in frames:
            if frame.number in plain:
                yield frame, (frame.records or [], True)
            else:
                yield frame, self.read(frame.raw, frame.key, problems)

    def read(self, raw: bytes, frame: str, problems: Problems) -> tuple[list[R], bool] | None:
        """The usable records of a frame, and whether every record was; None where the frame is no list."""
        found = self.decode(raw)
        if found is not None and len(found) <= MAX_RECORDS and self.plain(found, raw):
            return found, True
        records = []
        try:
            spans = []
            for span in elements(raw):
                spans.append(span)
                if len(spans) > MAX_RECORDS:
                    problems.add("frame", f"frame with more than {MAX_RECORDS} records", frame=frame)
                    return None
        except MalformedError as error:
            problems.add("frame", "frame is no list of records", frame=frame, value=str(error))
            return None
        for begin, end in spans:
            record = self._one(raw[begin:end], frame, problems)
            if record is not None:
                records.append(record)
        return records, len(records) == len(spans)

    def _one(self, raw: bytes, frame: str, problems: Problems) -> R | None:
        try:
            record = self._record.decode(raw)
            if self.plain([record], raw):
                return record
        except BROKEN:
            pass
        return self._repair(raw, frame, problems)

    def plain(self, records: list[R], raw: bytes) -> bool:
        """Whether no key is repeated, none being written with escapes, so that decoding lost nothing."""
        # Looking for one byte is many times as fast as for two.
        if b"\\" in raw and b"\\u" in raw:
            return False
        written = WrittenKeys(raw)
        for keys, fields in self._once:
            if written.exceed(sum(_having(records, field) for field in fields), *keys):
                return False
        return self._clean(records, written)


def _having(records: list[R], field: msgspec.structs.FieldInfo) -> int:
    """Records that have a field; one with the default written out counts as lacking it."""
    if field.required:
        return len(records)
    return sum(map(is_not, map(attrgetter(field.name), records), repeat(field.default)))


class Frame(NamedTuple):
    """One frame of a label file."""

    number: int
    key: str
    raw: bytes
    """Its value."""
    records: list[Any] | None
    """What decoding made of it, if that was tried and succeeded."""


def read_frames(
    path: Path, suffixes: tuple[str, ...], decode: Callable[[bytes], list[Any] | None], problems: Problems
) -> Iterator[Frame]:
    """The frames of a label file; the first of equal keys. `decode` reads clean frames, as `RecordReader.decode`.

    Raises InputError, naming the file, if the file cannot be read as a whole. That may happen after frames were
    yielded: whoever reads keeps nothing of such a file.
    """
    key_form = re.compile(r"([0-9]{6})\.(?:" + "|".join(suffixes) + ")")
    seen: set[int] = set()
    for key, raw, records in _cut(path, lambda raw: decode(raw) if len(raw) <= MAX_FRAME else None, problems):
        match = key_form.fullmatch(key)
        if match is None:
            problems.add("frame", "frame key is not six digits and " + "/".join(suffixes), frame=shorten(key))
        elif int(match[1]) in seen:
            problems.add("frame", "frame key twice, the first is kept", frame=key)
        elif len(raw) > MAX_FRAME:
            problems.add("frame", f"frame larger than {MAX_FRAME >> 20} MB", frame=key)
        else:
            seen.add(int(match[1]))
            yield Frame(int(match[1]), key, raw, records)


def read_file(path: Path) -> bytes:
    """The bytes of a label file. Raises InputError if it is no file, too large, unreadable, empty or not UTF-8."""
    name = path.name
    try:
        _check(path, MAX_FILE)
        data = path.read_bytes()
    except OSError as error:
        raise _unreadable(name, error) from None
    if not data or data.isspace():
        raise InputError(f"{name}: the file is empty", file=name)
    if not data.isascii():
        # Piece by piece: as one text it could take four times the bytes.
        decoder = codecs.getincrementaldecoder("utf-8")()
        for begin in range(0, len(data), _PIECE):
            behind = len(decoder.getstate()[0])
            try:
                decoder.decode(data[begin : begin + _PIECE], final=begin + _PIECE >= len(data))
            except UnicodeDecodeError as error:
                raise InputError(f"{name}: not UTF-8 at byte {begin - behind + error.start}", file=name) from None
    return data


def _check(path: Path, limit: int, of: str = "") -> None:
    """Raises InputError for what is no file or larger than the limit, OSError for what cannot be looked at."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path.name}: not a file", file=path.name)
    if status.st_size > limit:
        size = f"{status.st_size / (1 << 20):.0f} MB"
        raise InputError(f"{path.name}: {size}, larger than the limit of {limit >> 20} MB{of}", file=path.name)


def _unreadable(name: str, error: OSError) -> InputError:
    return InputError(f"{name}: cannot be read: {os.strerror(error.errno or errno.EIO)}", file=name)


def _cut(
    path: Path, decode: Callable[[bytes], list[Any] | None], problems: Problems
) -> Iterator[tuple[str, bytes, list[Any] | None]]:
    """Keys, texts and decoded records of frames, in the order of the file, repeated keys included."""
    name = path.name
    found = 0
    try:
        _check(path, MAX_FRAMED)
        with path.open("rb") as file:
            try:
                for frame in frame_texts(file, decode):
                    yield frame
                    found += 1
                return
            except OtherLayoutError:
                pass
        _check(path, MAX_FILE, " of files not laid out as usual (is it whole?)")
    except OSError as error:
        raise _unreadable(name, error) from None
    for key, raw in islice(_scan(read_file(path).removeprefix(codecs.BOM_UTF8), name, problems), found, None):
        yield key, raw, None


def _scan(data: bytes, name: str, problems: Problems) -> Iterator[tuple[str, bytes]]:
    try:
        end, found = 0, []
        for key, begin, stop in members(data):
            end = stop
            if key_text(key) == "labels":
                found.append(begin)
        if not end_of_text(data, end):
            raise InputError(f"{name}: not JSON: there is text after its end", file=name)
        if not found:
            raise InputError(f'{name}: there is no object "labels"', file=name)
        if data[found[0] : found[0] + 1] != b"{":
            raise InputError(f'{name}: "labels" is not an object', file=name)
        if len(found) > 1:
            problems.add("file", "key twice, the first is kept", field="labels", count=len(found) - 1)
        for key, begin, stop in members(data, found[0]):
            yield key_text(key), data[begin:stop]
    except MalformedError as error:
        raise InputError(f"{name}: not JSON: {error}", file=name) from None


def key_text(key: bytes) -> str:
    """The text of a quoted key; what is no JSON text is read as it stands."""
    try:
        return msgspec.json.decode(key, type=str)
    except BROKEN:
        return key.decode("utf-8", "replace")
