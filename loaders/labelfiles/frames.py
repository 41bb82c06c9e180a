"""A JRDB label file, `{"labels": {"<frame>.<suffix>": [record, ...]}}`, read frame by frame into columns.

The file is cut into raw frames and each frame is decoded alone: what is broken stays in its own frame or record.
Decoded records are the largest thing in memory, so they live for a batch of frames only. What repeats from record to
record (label ids, raw label objects) is numbered; the numbers are the columns. A file that cannot be used as a whole
raises InputError.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, islice, repeat
from operator import attrgetter, is_not
from pathlib import Path
from typing import Any, Final, Generic, NamedTuple, TypeVar

import msgspec
import numpy as np

from jrdb_avr.loaders.labelfiles.columns import Columns, Distinct, numbered
from jrdb_avr.loaders.labelfiles.json import BROKEN, MalformedError, elements, keys_exceed, members
from jrdb_avr.loaders.labelfiles.records import TWICE, Rules, read_fields, record_parts
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.errors import InputError

MAX_FILE: Final = 320 << 20
"""Bytes of the largest file that is read: twice those of JRDB's fullest sequence."""
_PIECE: Final = 1 << 20
_WINDOW: Final = 8 << 20
_MAX_FRAME: Final = 4 << 20
MAX_RECORDS: Final = 1000
"""Records of one frame: JRDB's fullest have about a hundred, and pairs of people grow with the square."""
MAX_GATHERED: Final = 400_000
"""Records of one file; twice as many as JRDB's fullest sequence has boxes."""
BATCH_BYTES: Final = 1 << 19
"""Bytes of text of the frames that are read together."""

_BLANK: Final = b" \t\r\n"
_OPENING: Final = re.compile(
    rb'(?:\xef\xbb\xbf)?_\{_"labels"_:_\{_"[0-9]{6}(\.[a-z]{3,4})"_:_'.replace(b"_", rb"[ \t\r\n]*")
)
_CLOSING: Final = re.compile(rb"\}[ \t\r\n]*\}[ \t\r\n]*\Z")
_VALUE: Final = msgspec.json.Decoder(msgspec.Raw)

_R = TypeVar("_R", bound=msgspec.Struct)
Keys = tuple[str | tuple[str, ...], ...]


class Frame(NamedTuple):
    """One frame of a label file."""

    number: int
    key: str
    raw: bytes
    """Its value."""
    records: list[Any] | None
    """The value decoded, where it is a list of records that all decode; repeated keys may be lost."""


def _nothing_more(parts: dict[str, bytes], place: str, problems: Problems) -> dict[str, Any]:
    return {}


class RecordReader(Generic[_R]):
    """Decodes records of type R: many frames at once where they are clean, else frame by frame or record by record.

    `rules` say how fields of a record that does not decode are read; raw fields need none. `once` names the fields that
    a record has at most once, fields of one meaning together: where a text holds their keys more often than decoded
    records have them, a record repeats one (JSON leaves open which of the two counts). `inner_keys` gives keys inside
    decoded records with their number; None where a record must be looked at alone. `place` names a record in the
    report, where that is not its frame; `more` reads fields that no rule can, and those that refused ones fall back to.
    """

    def __init__(
        self,
        record: type[_R],
        rules: Rules,
        once: Keys,
        inner_keys: Callable[[list[_R]], list[tuple[int, tuple[bytes, ...]]] | None] = lambda records: [],
        place: Callable[[dict[str, bytes], str], str] = lambda parts, frame: frame,
        more: Callable[[dict[str, bytes], str, Problems], dict[str, Any]] = _nothing_more,
        within: str = "",
    ) -> None:
        self._frame = msgspec.json.Decoder(list[record])  # type: ignore[valid-type]
        self._type, self._rules, self._inner_keys, self._place, self._more = record, rules, inner_keys, place, more
        self._within = within
        info = {field.name: field for field in msgspec.structs.fields(record)}
        self._raw = [name for name, field in info.items() if field.type is msgspec.Raw]
        groups = [[info[name] for name in ((group,) if isinstance(group, str) else group)] for group in once]
        self._once = [(tuple(f'"{field.encode_name}"'.encode() for field in group), group) for group in groups]

    def read(self, frames: Sequence[Frame], problems: Problems) -> Iterator[tuple[Frame, list[_R], bool]]:
        """Frames that are lists, the usable records of each, and whether every record of it is usable."""
        decoded = [frame.records if len(frame.records or ()) <= MAX_RECORDS else None for frame in frames]
        # Looking for repeated keys in few long texts takes half the time of looking in many short ones.
        clean = [(frame.raw, records) for frame, records in zip(frames, decoded, strict=True) if records is not None]
        all_plain = self._plain(list(chain.from_iterable(item[1] for item in clean)), b",".join(i[0] for i in clean))
        for frame, records in zip(frames, decoded, strict=True):
            if records is not None and (all_plain or self._plain(records, frame.raw)):
                yield frame, records, True
            else:
                yield from self._one_by_one(frame, problems)

    def decode(self, raw: bytes, most: int) -> list[_R] | None:
        """All records of a list, where decoding loses nothing and they are no more than `most`."""
        records = self.decode_quickly(raw)
        return records if records is not None and len(records) <= most and self._plain(records, raw) else None

    def decode_quickly(self, raw: bytes) -> list[_R] | None:
        """All records of a list, where they decode; repeated keys may be lost."""
        try:
            records: list[_R] = self._frame.decode(raw)
        except BROKEN:
            return None
        return records

    def _plain(self, records: list[_R], text: bytes) -> bool:
        """Whether no key is repeated, none being written with escapes, so that decoding lost nothing."""
        # Looking for one byte is many times as fast as for two.
        inner = None if b"\\" in text and b"\\u" in text else self._inner_keys(records)
        return inner is not None and not keys_exceed(
            text, [(sum(_having(records, field) for field in group), keys) for keys, group in self._once] + inner
        )

    def _one_by_one(self, frame: Frame, problems: Problems) -> Iterator[tuple[Frame, list[_R], bool]]:
        try:
            raws: list[bytes] = []
            for raw in elements(frame.raw):
                raws.append(bytes(raw))
                if len(raws) > MAX_RECORDS:
                    problems.add("frame", f"frame with more than {MAX_RECORDS} records", frame=frame.key)
                    return
        except MalformedError as error:
            problems.add("frame", "frame is no list of records", frame=frame.key, value=str(error))
            return
        found = []
        for record in raws:
            found += self.decode(b"[" + record + b"]", 1) or self._repair(record, frame.key, problems)
        yield frame, found, len(found) == len(raws)

    def _repair(self, raw: bytes, frame: str, problems: Problems) -> list[_R]:
        """What can be used of a record that does not decode as it stands; nothing, with the reason counted, if none."""
        try:
            parts = record_parts(raw, frame, problems)
        except MalformedError:
            problems.add("record", "record is no object", frame=frame, value=raw)
            return []
        place = self._place(parts, frame)
        values = read_fields(parts, self._rules, place, problems, self._within)
        if values is None:
            return []
        values |= {name: msgspec.Raw(parts[name]) for name in self._raw if name in parts}
        return [self._type(**(self._more(parts, place, problems) | values))]


def _having(records: list[Any], field: msgspec.structs.FieldInfo) -> int:
    """Records that have a field; one with the default written out counts as lacking it."""
    if field.required:
        return len(records)
    return sum(map(is_not, map(attrgetter(field.name), records), repeat(field.default)))


@contextlib.contextmanager
def _named_errors(name: str) -> Iterator[None]:
    """Errors of the system and of the text's structure as InputError with the file's name."""
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno or errno.EIO)
        raise InputError(f"{name}: cannot be read: {reason}", file=name) from None
    except MalformedError as error:
        raise InputError(f"{name}: not JSON: {error}", file=name) from None


def _check_file(path: Path) -> None:
    """Check that a path is a regular file and not too large. Raises InputError, or OSError if it cannot be examined."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path.name}: not a file", file=path.name)
    if status.st_size > MAX_FILE:
        size = f"{status.st_size / (1 << 20):.0f} MB"
        raise InputError(f"{path.name}: {size}, larger than the limit of {MAX_FILE >> 20} MB", file=path.name)


def read_file(path: Path) -> bytes:
    """The text of a label file, without a byte order mark.

    Raises InputError if it is no file, too large, unreadable, empty or not UTF-8.
    """
    name = path.name
    with _named_errors(name):
        _check_file(path)
        data = path.read_bytes()
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
    return data.removeprefix(codecs.BOM_UTF8)


def read_frames(
    path: Path, suffixes: tuple[str, ...], reader: RecordReader[Any], problems: Problems
) -> Iterator[Frame]:
    """The frames of a label file; the first of equal keys.

    Raises InputError, naming the file, if the file cannot be read as a whole. That may happen after frames were
    yielded: whoever reads uses nothing of such a file.
    """
    key_form = re.compile(r"([0-9]{6})\.(?:" + "|".join(suffixes) + ")")
    seen: set[int] = set()
    with _named_errors(path.name):
        for key, raw, records in _frame_texts(path, reader, problems):
            match = key_form.fullmatch(key)
            if match is None:
                problems.add("frame", "frame key is not six digits and " + "/".join(suffixes), frame=shorten(key))
            elif int(match[1]) in seen:
                problems.add("frame", "frame key twice, the first is kept", frame=key)
            elif len(raw) > _MAX_FRAME:
                problems.add("frame", f"frame larger than {_MAX_FRAME >> 20} MB", frame=key)
            else:
                seen.add(int(match[1]))
                yield Frame(int(match[1]), key, raw, records)


def _frame_texts(
    path: Path, reader: RecordReader[Any], problems: Problems
) -> Iterator[tuple[str, bytes, list[Any] | None]]:
    """Keys, raw values and decoded records of frames, in the order of the file, repeated keys included."""

    def decoded(raw: bytes) -> list[Any] | None:
        return reader.decode_quickly(raw) if len(raw) <= _MAX_FRAME else None

    found = 0
    _check_file(path)
    for key, raw in _usual_frames(path):
        records = decoded(raw)
        if not _is_utf8(raw) or (records is None and not _is_json(raw)):
            break
        yield key, raw, records
        found += 1
    else:
        if found:
            return
    # The frames found until here are those that the scanner finds first.
    labels = scanned_sections(read_file(path), ("labels",), problems).get("labels")
    if labels is None:
        raise InputError(f'{path.name}: there is no object "labels"', file=path.name)
    if bytes(labels[:1]) != b"{":
        raise InputError(f'{path.name}: "labels" is not an object', file=path.name)
    for key, value in islice(members(labels), found, None):
        yield key, bytes(value), decoded(bytes(value))


def _usual_frames(path: Path) -> Iterator[tuple[str, bytes]]:
    """Keys and raw values of a file that is laid out as usual: of frames only, under keys with one suffix.

    A quote before six digits begins a key, at whatever depth. So where each value is one whole JSON value and a comma
    follows, the text has no other reading; any other text ends in a value that is none. The file is read window by
    window: it need not be in memory while the columns grow.
    """
    with path.open("rb") as file:
        text = file.read(_WINDOW)
        opening = _OPENING.match(text)
        if opening is None:
            return
        # A search that begins with a literal is many times as fast.
        suffix, width = re.escape(opening[1]), len(opening[1])
        later = re.compile(suffix + rb'(?<="[0-9]{6}' + suffix + rb')"[ \t\r\n]*:[ \t\r\n]*')
        place, begin = opening.start(1), opening.end()
        search = begin
        name = text[place - 6 : place + width].decode()
        while len(text) - begin <= _MAX_FRAME + 2 * _WINDOW:
            if key := later.search(text, search):
                raw = text[begin : key.start() - 7].rstrip(_BLANK)
                # Without its comma a value is broken.
                yield name, raw[:-1].rstrip(_BLANK) if raw.endswith(b",") else b""
                name = text[key.start() - 6 : key.start() + width].decode()
                begin = search = key.end()
            elif more := file.read(_WINDOW):
                # A key may be cut by the end of the window.
                text, search = text[begin:] + more, max(0, len(text) - begin - 100)
                begin = 0
            else:
                closing = _CLOSING.search(text, max(begin, len(text) - 100))
                yield name, text[begin : closing.start()].rstrip(_BLANK) if closing else b""
                return
        # The text goes on beyond the window: an end that is seen in it need not be the end.
        yield name, b""


def _is_utf8(value: bytes) -> bool:
    try:
        return value.isascii() or bool(value.decode())
    except UnicodeError:
        return False


def _is_json(value: bytes) -> bool:
    """Whether a text is one whole JSON value."""
    try:
        _VALUE.decode(value)
    except BROKEN:
        return False
    return True


def scanned_sections(data: bytes, wanted: Sequence[str], problems: Problems) -> dict[str, memoryview]:
    """The wanted members of the outermost object of a file, the first of equal keys. Raises MalformedError."""
    found: dict[str, memoryview] = {}
    for key, value in members(data):
        if key in found:
            problems.add("file", TWICE, field=key)
        elif key in wanted:
            found[key] = value
    return found


# -- columns -------------------------------------------------------------------------------------------------------


class Gathered(NamedTuple):
    """Columns of all usable records of a file, in its order."""

    columns: Columns
    """`frame` beside those of the layer."""
    known: list[int]
    """Frames that are lists."""
    complete: list[int]
    """Frames of which every record is usable."""


def gather(
    path: Path,
    suffixes: tuple[str, ...],
    reader: RecordReader[_R],
    take: Callable[[list[_R]], Columns],
    problems: Problems,
) -> Gathered:
    """Read a label file. `take` makes columns of records. Raises InputError if the file as a whole cannot be used."""
    known: list[int] = []
    complete: list[int] = []
    parts: list[Columns] = []
    size = 0
    for batch in byte_batches(read_frames(path, suffixes, reader, problems), lambda frame: len(frame.raw)):
        read = list(reader.read(batch, problems))
        known += [frame.number for frame, _, _ in read]
        complete += [frame.number for frame, _, whole in read if whole]
        records = list(chain.from_iterable(found for _, found, _ in read))
        numbers = np.array([frame.number for frame, _, _ in read], np.int64)
        counts = np.array([len(found) for _, found, _ in read], np.int64)
        parts.append({"frame": np.repeat(numbers, counts), **take(records)})
        size += len(records)
        if size > MAX_GATHERED:
            raise InputError(f"{path.name}: more than {MAX_GATHERED:,} records", file=path.name)
    columns = {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}
    return Gathered(columns, known, complete)


T = TypeVar("T")


def byte_batches(items: Iterable[T], size: Callable[[T], int], most: int | None = None) -> Iterator[list[T]]:
    """Items in order, in batches of about BATCH_BYTES and of no more than `most`; at least one, which may be empty."""
    batch: list[T] = []
    total = 0
    for item in items:
        batch.append(item)
        total += size(item)
        if total >= BATCH_BYTES or len(batch) == most:
            yield batch
            batch, total = [], 0
    yield batch


def take_fields(records: list[Any], names: Iterable[str], codes: dict[str, Distinct]) -> Columns:
    """Columns of fields as the numbers of their values; raw fields by their bytes."""
    columns = {}
    for name in names:
        values: Any = map(attrgetter(name), records)
        if records and isinstance(getattr(records[0], name), msgspec.Raw):
            values = map(bytes, values)
        columns[name] = numbered(codes[name], values, len(records))
    return columns
