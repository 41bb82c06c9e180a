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
from collections.abc import Callable, Iterator
from itertools import repeat
from operator import attrgetter, is_not
from pathlib import Path
from typing import Final, Generic, TypeVar

import msgspec

from jrdb_avr.schema.errors import InputError

from .jsonscan import MalformedError, elements, end_of_text, holds_only, members
from .problems import Problems, shorten

MAX_FILE: Final = 160 << 20
"""Bytes of the largest file that is read; twice the largest real one, all layers in it. One of 190 MB took 741 MB."""
MAX_FRAME: Final = 4 << 20
MAX_RECORDS: Final = 1000
"""Records of one frame: JRDB's fullest have about a hundred, and pairs of people grow with the square."""
SCAN_FROM: Final = 64 << 20
"""Files from this size on are cut by the scanner, whose memory does not depend on the number of members."""

R = TypeVar("R", bound=msgspec.Struct)

BROKEN: Final = (msgspec.DecodeError, RecursionError, UnicodeError)


class _File(msgspec.Struct, gc=False):
    labels: dict[str, msgspec.Raw]


class RecordReader(Generic[R]):
    """Decodes records of type R: whole frames at once where they are clean, else one by one.

    `repair` gets the bytes of a record that is not clean, the frame key and the problems, and returns what can be used
    of it or None. `once` names the fields that a record has at most once, fields of one meaning together: where a frame
    holds their keys more often than decoded records have them, a record repeats one (JSON leaves open which of the two
    counts), and the frame is taken record by record. `clean` looks deeper into decoded records and their bytes.
    """

    def __init__(
        self,
        record: type[R],
        repair: Callable[[bytes, str, Problems], R | None],
        once: tuple[str | tuple[str, ...], ...],
        clean: Callable[[list[R], bytes], bool] = lambda records, raw: True,
    ) -> None:
        self._frame = msgspec.json.Decoder(list[record])  # type: ignore[valid-type]
        self._record = msgspec.json.Decoder(record)
        self._repair = repair
        info = {field.name: field for field in msgspec.structs.fields(record)}
        groups = [[info[name] for name in ((group,) if isinstance(group, str) else group)] for group in once]
        self._once = [[(f'"{field.encode_name}"'.encode(), field) for field in group] for group in groups]
        self._clean = clean

    def read(self, raw: bytes, frame: str, problems: Problems) -> tuple[list[R], bool] | None:
        """The usable records of a frame, and whether every record was; None where the frame is no list."""
        try:
            records = self._frame.decode(raw)
            if len(records) <= MAX_RECORDS and self.plain(records, raw):
                return records, True
        except BROKEN:
            pass
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
        once = all(
            sum(raw.count(key) for key, _ in group) <= sum(_having(records, field) for _, field in group)
            for group in self._once
        )
        return once and b"\\u" not in raw and self._clean(records, raw)


def _having(records: list[R], field: msgspec.structs.FieldInfo) -> int:
    """Records that have a field; one with the default written out counts as lacking it."""
    if field.required:
        return len(records)
    return sum(map(is_not, map(attrgetter(field.name), records), repeat(field.default)))


def read_frames(path: Path, suffixes: tuple[str, ...], problems: Problems) -> Iterator[tuple[int, str, bytes]]:
    """Frame number, frame key and raw list of each frame of a label file; the first of equal keys.

    Raises InputError, naming the file, if the file cannot be read as a whole. That may happen after frames were
    yielded: whoever reads keeps nothing of such a file.
    """
    data = read_file(path).removeprefix(codecs.BOM_UTF8)
    key_form = re.compile(r"([0-9]{6})\.(?:" + "|".join(suffixes) + ")")
    seen: set[int] = set()
    for key, raw in _cut(data, path, problems):
        match = key_form.fullmatch(key)
        if match is None:
            problems.add("frame", "frame key is not six digits and " + "/".join(suffixes), frame=shorten(key))
        elif int(match[1]) in seen:
            problems.add("frame", "frame key twice, the first is kept", frame=key)
        elif len(raw) > MAX_FRAME:
            problems.add("frame", f"frame larger than {MAX_FRAME >> 20} MB", frame=key)
        else:
            seen.add(int(match[1]))
            yield int(match[1]), key, raw


def read_file(path: Path) -> bytes:
    """The bytes of a label file. Raises InputError if it is no file, too large, unreadable, empty or not UTF-8."""
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
        reason = os.strerror(error.errno or errno.EIO)
        raise InputError(f"{name}: cannot be read: {reason}", file=name) from None
    if not data or data.isspace():
        raise InputError(f"{name}: the file is empty", file=name)
    if not data.isascii():
        try:
            data.decode()
        except UnicodeDecodeError as error:
            raise InputError(f"{name}: not UTF-8 at byte {error.start}", file=name) from None
    return data


def _cut(data: bytes, path: Path, problems: Problems) -> Iterator[tuple[str, bytes]]:
    """Frame keys and raw frames, in the order of the file, repeated keys included."""
    if len(data) < SCAN_FROM and data.count(b'"labels"') == 1:
        try:
            labels = msgspec.json.decode(data, type=_File).labels
        except BROKEN:
            pass  # the scanner finds what is usable
        else:
            # Of a repeated key, decoding keeps the last only: then the text holds more than the frames read.
            if holds_only(data, data.index(b'"labels"') + len(b'"labels"'), map(bytes, labels.values())):
                for key, raw in labels.items():
                    yield key, bytes(raw)
                return
    yield from _scan(data, path.name, problems)


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
    try:
        return msgspec.json.decode(key, type=str)
    except BROKEN:
        return key.decode("utf-8", "replace")
