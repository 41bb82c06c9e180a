"""A JRDB label file, `{"labels": {"<frame>.<suffix>": [record, ...]}}`, read some frames at a time into columns.

The file is cut into texts of several frames. A text that is clean is decoded at once; any other is cut into frames, and
each is decoded alone: what is broken stays in its own frame or record.
Decoded records are the largest thing in memory, so they live for a batch of frames only. What repeats from record to
record (label ids, raw label objects) is numbered; the numbers are the columns. A file that cannot be used as a whole
raises InputError.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import functools
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import msgspec
import numpy as np

from jrdb_avr.loaders.labelfiles.columns import Columns, Distinct, numbered
from jrdb_avr.loaders.labelfiles.json import BROKEN, MalformedError, members
from jrdb_avr.loaders.labelfiles.record_reader import FIRST_KEY, Fields, Frame, RecordReader, is_utf8
from jrdb_avr.loaders.labelfiles.records import TWICE
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.errors import InputError

MAX_FILE: Final = 320 << 20
"""Bytes of the largest file that is read: twice those of JRDB's fullest sequence."""
_PIECE: Final = 1 << 20
_WINDOW: Final = 1 << 18
"""Bytes read at once; pieces larger than the processor's cache take twice as long."""
_MAX_FRAME: Final = 4 << 20
MAX_GATHERED: Final = 400_000
"""Records of one file; twice as many as JRDB's fullest sequence has boxes."""
BATCH_BYTES: Final = 1 << 17
"""Bytes of text of the frames that are read together: so few that their records stay in the processor's cache."""

_BLANK: Final = b" \t\r\n"
_OPENING: Final = re.compile(
    rb'(?:\xef\xbb\xbf)?_\{_"labels"_:_\{_"[0-9]{6}(\.[a-z]{3,4})"_:_'.replace(b"_", rb"[ \t\r\n]*")
)
_CLOSING: Final = re.compile(rb"\}[ \t\r\n]*\}[ \t\r\n]*\Z")
_VALUE: Final = msgspec.json.Decoder(msgspec.Raw)

_R = TypeVar("_R", bound=msgspec.Struct)

_Members = Iterable[tuple[str, bytes, list[Any] | None]]
"""Key, raw value and decoded records of frames, as `Frame` has them."""


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
) -> Iterator[tuple[list[Frame], Fields | None]]:
    """The frames of a label file in batches, of equal keys the first; and the fields of a batch's records, where those
    are all there is of it.

    Raises InputError, naming the file, if the file cannot be read as a whole. That may happen after frames were
    yielded: whoever reads uses nothing of such a file.
    """
    key_form = re.compile(r"([0-9]{6})\.(?:" + "|".join(suffixes) + ")")
    seen: set[int] = set()

    def usable(found: _Members) -> Iterator[Frame]:
        for key, raw, records in found:
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

    with _named_errors(path.name):
        for found, fields in _members_of(path, reader, problems):
            if fields is None:
                for batch in byte_batches(usable(found), lambda frame: len(frame.raw)):
                    yield batch, None
            else:
                batch = [*usable(found)]
                yield batch, fields if len(batch) == len([*found]) else reader.fields(_records_of(batch))


def _records_of(frames: Iterable[Frame]) -> list[Any]:
    return [*chain.from_iterable(frame.records or () for frame in frames)]


def _members_of(path: Path, reader: RecordReader[Any], problems: Problems) -> Iterator[tuple[_Members, Fields | None]]:
    """All frames in the order of the file, repeated keys included, and the fields of their records where those are all
    there is."""
    count = 0
    _check_file(path)
    for text in _usual_texts(path):
        if len(text) <= _MAX_FRAME and (decoded := reader.decode_frames(text)):
            yield [(key, b"", records) for key, records in decoded[0].items()], decoded[1]
            count += len(decoded[0])
            continue
        cut, usual = _cut(text, reader)
        yield cut, None
        count += len(cut)
        if not usual:
            break
    else:
        if count:
            return
    # The frames found until here are those that the scanner finds first.
    labels = scanned_sections(read_file(path), ("labels",), problems).get("labels")
    if labels is None:
        raise InputError(f'{path.name}: there is no object "labels"', file=path.name)
    if bytes(labels[:1]) != b"{":
        raise InputError(f'{path.name}: "labels" is not an object', file=path.name)
    yield ((key, bytes(raw), _decoded(bytes(raw), reader)) for key, raw in islice(members(labels), count, None)), None


def _decoded(raw: bytes, reader: RecordReader[Any]) -> list[Any] | None:
    return reader.decode_quickly(raw) if len(raw) <= _MAX_FRAME else None


def _usual_texts(path: Path) -> Iterator[bytes]:
    """Texts of about BATCH_BYTES, each of some whole frames with their keys, of a file that is laid out as usual: of
    frames only, under keys with one suffix.

    A quote before six digits begins a key, at whatever depth. So where each value is one whole JSON value and a comma
    follows, the text has no other reading; of any other file a text is empty, or has a value that is none. The file is
    read window by window: it need not be in memory while the columns grow.
    """
    with path.open("rb") as file:
        text = file.read(_WINDOW)
        opening = _OPENING.match(text)
        if opening is None:
            return
        key_form = _later_key(opening[1])
        begin, search = opening.start(1) - 7, opening.end() + BATCH_BYTES
        while len(text) - begin <= _MAX_FRAME + 2 * _WINDOW:
            if key := key_form.search(text, search):
                end = key.start() - 7
                yield _before_comma(text[begin:end])
                begin, search = end, key.end() + BATCH_BYTES
            elif more := file.read(_WINDOW):
                # A key may be cut by the end of the window.
                text, search = text[begin:] + more, max(search - begin, len(text) - begin - 100)
                begin = 0
            else:
                closing = _CLOSING.search(text, max(begin, len(text) - 100))
                yield text[begin : closing.start()].rstrip(_BLANK) if closing else b""
                return
        # The text goes on beyond the window: an end that is seen in it need not be the end.
        yield b""


@functools.cache
def _later_key(suffix: bytes) -> re.Pattern[bytes]:
    """A frame's key from its suffix on. (A search that begins with a literal is many times as fast.)"""
    end = re.escape(suffix)
    return re.compile(end + rb'(?<="[0-9]{6}' + end + rb')"[ \t\r\n]*:[ \t\r\n]*')


def _before_comma(text: bytes) -> bytes:
    """A text without the comma that it ends with; nothing where it lacks it, which is then broken."""
    text = text.rstrip(_BLANK)
    return text[:-1].rstrip(_BLANK) if text.endswith(b",") else b""


def _cut(text: bytes, reader: RecordReader[Any]) -> tuple[list[tuple[str, bytes, list[Any] | None]], bool]:
    """The frames of a text up to the first that is broken, and whether there is none such."""
    first = FIRST_KEY.match(text)
    if first is None:
        return [], False
    keys = [*_later_key(first[1]).finditer(text)]
    found: list[tuple[str, bytes, list[Any] | None]] = []
    for key, later in zip(keys, [*keys[1:], None], strict=True):
        raw = _before_comma(text[key.end() : later.start() - 7]) if later else text[key.end() :]
        records = _decoded(raw, reader)
        if not is_utf8(raw) or (records is None and not _is_json(raw)):
            return found, False
        name = text[key.start() - 6 : key.start() + len(first[1])]
        found.append((name.decode(), raw, records))
    return found, True


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
    take: Callable[[Fields], Columns],
    problems: Problems,
) -> Gathered:
    """Read a label file. `take` makes columns of the fields of records.

    Raises InputError if the file as a whole cannot be used.
    """
    known: list[int] = []
    complete: list[int] = []
    parts: list[Columns] = []
    size = 0
    for batch, fields in read_frames(path, suffixes, reader, problems):
        if fields is None:
            read = [*reader.read(batch, problems)]
            fields = reader.fields([*chain.from_iterable(records for _, records, _ in read)])
        else:
            read = [(frame, frame.records or [], True) for frame in batch]
        known += [frame.number for frame, _, _ in read]
        complete += [frame.number for frame, _, whole in read if whole]
        numbers = np.array([frame.number for frame, _, _ in read], np.int64)
        counts = np.array([len(found) for _, found, _ in read], np.int64)
        parts.append({"frame": np.repeat(numbers, counts), **take(fields)})
        size += int(counts.sum())
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


def take_fields(fields: Fields, names: Iterable[str], codes: dict[str, Distinct]) -> Columns:
    """Columns of fields as the numbers of their values; raw fields by their bytes."""
    columns = {}
    for name in names:
        values = fields[name]
        raw = isinstance(next(iter(values), None), msgspec.Raw)
        columns[name] = numbered(codes[name], raw_bytes(values) if raw else values, len(values))
    return columns


def raw_bytes(raws: Sequence[msgspec.Raw]) -> Iterable[bytes]:
    """The bytes of raw values. As parts of one text they take two thirds of the time."""
    found = b"\0".join(raws).split(b"\0")
    return found if len(found) == len(raws) else map(bytes, raws)
