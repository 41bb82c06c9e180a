"""Decode the records of label files: clean ones many at once, others one by one with repairs."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from itertools import chain, repeat
from typing import Any, Final, Generic, NamedTuple, TypeVar

import msgspec

from jrdb_avr.loaders.labelfiles.json import BROKEN, Limit, MalformedError, elements, keys_exceed
from jrdb_avr.loaders.labelfiles.records import Rules, read_fields, record_parts
from jrdb_avr.loaders.problems import Problems

MAX_RECORDS: Final = 1000
"""Records of one frame: JRDB's fullest have about a hundred, and pairs of people grow with the square."""

FIRST_KEY: Final = re.compile(rb'"[0-9]{6}(\.[a-z]{3,4})"')
"""The key of a frame, with its suffix."""

_R = TypeVar("_R", bound=msgspec.Struct)
Keys = tuple[str | tuple[str, ...], ...]
Fields = dict[str, tuple[Any, ...]]
"""The values of records by field."""


class Frame(NamedTuple):
    """One frame of a label file."""

    number: int
    key: str
    raw: bytes
    """Its value; empty where it was decoded together with others, and nothing was lost."""
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
        inner_keys: Callable[[Fields], list[Limit] | None] = lambda fields: [],
        place: Callable[[dict[str, bytes], str], str] = lambda parts, frame: frame,
        more: Callable[[dict[str, bytes], str, Problems], dict[str, Any]] = _nothing_more,
        within: str = "",
    ) -> None:
        self._frame = msgspec.json.Decoder(list[record])  # type: ignore[valid-type]
        self._frames = msgspec.json.Decoder(dict[str, list[record]])  # type: ignore[valid-type]
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
        every = self.fields([*chain.from_iterable(records for _, records in clean)])
        all_plain = self._plain(every, b",".join(raw for raw, _ in clean))
        for frame, records in zip(frames, decoded, strict=True):
            if records is not None and (all_plain or self._plain(self.fields(records), frame.raw)):
                yield frame, records, True
            else:
                yield from self._one_by_one(frame, problems)

    def fields(self, records: list[_R]) -> Fields:
        """The values of records by field: taken together, they take a third of the time of one field at a time."""
        columns = zip(*map(msgspec.structs.astuple, records), strict=True) if records else repeat(())
        return dict(zip(self._type.__struct_fields__, columns, strict=False))

    def decode_frames(self, text: bytes) -> tuple[dict[str, list[_R]], Fields] | None:
        """The frames of a text by key, and the fields of all their records, where decoding loses nothing and no frame
        is too full."""
        first = FIRST_KEY.match(text)
        if first is None or not is_utf8(text):
            return None
        try:
            frames: dict[str, list[_R]] = self._frames.decode(b"{" + text + b"}")
        except BROKEN:
            return None
        if max(map(len, frames.values())) > MAX_RECORDS:
            return None
        # Of other keys one that is repeated could go unnoticed.
        suffix = first[1].decode()
        if any(len(key) != 6 + len(suffix) or not key.endswith(suffix) for key in frames):
            return None
        every = self.fields([*chain.from_iterable(frames.values())])
        return (frames, every) if self._plain(every, text, [(len(frames), (first[1] + b'"',))]) else None

    def decode(self, raw: bytes, most: int) -> list[_R] | None:
        """All records of a list, where decoding loses nothing and they are no more than `most`."""
        records = self.decode_quickly(raw)
        if records is None or len(records) > most or not self._plain(self.fields(records), raw):
            return None
        return records

    def decode_quickly(self, raw: bytes) -> list[_R] | None:
        """All records of a list, where they decode; repeated keys may be lost."""
        try:
            records: list[_R] = self._frame.decode(raw)
        except BROKEN:
            return None
        return records

    def _plain(self, fields: Fields, text: bytes, outer: Sequence[Limit] = ()) -> bool:
        """Whether no key is repeated, none being written with escapes, so that decoding lost nothing.

        `outer`: keys outside the records, with their number.
        """
        # Looking for one byte is many times as fast as for two.
        inner = None if b"\\" in text and b"\\u" in text else self._inner_keys(fields)
        once = ((sum(_having(fields[field.name], field) for field in group), keys) for keys, group in self._once)
        return inner is not None and not keys_exceed(text, [*outer, *once, *inner])

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


def _having(values: tuple[Any, ...], field: msgspec.structs.FieldInfo) -> int:
    """Records that have a field; one with the default written out counts as lacking it."""
    return len(values) - (0 if field.required else values.count(field.default))


def is_utf8(value: bytes) -> bool:
    """Whether bytes are UTF-8."""
    try:
        return value.isascii() or bool(value.decode())
    except UnicodeError:
        return False
