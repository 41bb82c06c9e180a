"""What the label records of every layer share: the person they are of, and repair of records that are not clean.

Single fields of label records: what counts as usable, and how spellings of one thing are read as one.

Every function takes a decoded JSON value of any type and raises ValueError, with the reason, where it is unusable.
"""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Sequence
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.loaders.labelfiles.jsonscan import MalformedError, members
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.arrays import Ints

MAX_TRACK: Final = 2**31 - 2
MAX_PIXEL: Final = 1e5
"""No coordinate of a stitched box is as large as this: the panorama has 3760 columns."""
MAX_METRE: Final = 1e4
MAX_TEXT: Final = 100

ABSENT: Final = (b"", b"null")
"""Raw values of a key that is not there: a null says no more than a missing key."""

_PERSON: Final = re.compile(r"pedestrian:([0-9]{1,10})")
_WHOLE: Final = re.compile(r"-?[0-9]{1,19}")
_PREFIXED: Final = re.compile(r"([A-Za-z_ ]+):(-?[0-9]+)")


class NotAPersonError(ValueError):
    """A well-formed label id of something that is no tracked person (another prefix, or -1)."""


def track_of(label_id: object) -> int:
    """The N of `pedestrian:N`. Raises NotAPersonError for other prefixes and -1, ValueError for anything else."""
    if not isinstance(label_id, str):
        raise ValueError("label_id is no text" if label_id is not None else "label_id is missing")
    match = _PERSON.fullmatch(label_id)
    if match and int(match[1]) <= MAX_TRACK:
        return int(match[1])
    if match is None and _PREFIXED.fullmatch(label_id):
        raise NotAPersonError("label_id is not of a tracked person")
    raise ValueError("label_id is not pedestrian:N")


def number(value: object) -> float:
    """A finite number; bool is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("not a number")
    try:
        result = float(value)
    except OverflowError:
        raise ValueError("number too large") from None
    if not math.isfinite(result):
        raise ValueError("not a finite number")
    return result


def whole(value: object, low: int, high: int) -> int:
    """A whole number in [low, high], also as 7.0 or "7"."""
    if type(value) is int and low <= value <= high:
        return value
    if isinstance(value, str) and _WHOLE.fullmatch(value):
        value = int(value)
    result = number(value)
    if result != math.floor(result):
        raise ValueError("not a whole number")
    # Integers beyond 2**53 keep their digits.
    exact = value if isinstance(value, int) else int(result)
    if not low <= exact <= high:
        raise ValueError("number out of range")
    return exact


def flag(value: object) -> bool:
    """A bool, also as "true" or "false" in any case."""
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.lower() in ("true", "false"):
        return value.lower() == "true"
    raise ValueError("neither true nor false")


def difficulty(value: object) -> int:
    """A difficulty code 1..3, also as 1.0 or "1"."""
    return whole(value, 1, 3)


@functools.lru_cache(maxsize=10_000)
def _clean(value: str) -> str:
    return "".join(c if c.isprintable() else " " for c in value).strip()


def text(value: object) -> str:
    """Text that can be stored and printed: no lone surrogates, no control characters, not empty, not endless."""
    if not isinstance(value, str):
        raise ValueError("not a text")
    clean = _clean(value)
    if not clean:
        raise ValueError("empty text")
    if len(clean) > MAX_TEXT:
        raise ValueError("text too long")
    return clean


def pairs(raw: bytes) -> tuple[list[tuple[str, Any]], list[str]]:
    """The members of a JSON object, first of equal keys, and the keys that stood there again.

    NaN and Infinity are let through, for the field's own check. Raises ValueError for anything but an object.
    """
    try:
        quick = msgspec.json.decode(raw)
    except (msgspec.DecodeError, RecursionError, UnicodeError):
        quick = None
    # A colon for each key and no other: none is repeated.
    if isinstance(quick, dict) and len(quick) == raw.count(b":"):
        return list(quick.items()), []
    return object_members(loose(raw))


def object_members(value: object) -> tuple[list[tuple[str, Any]], list[str]]:
    """As `pairs`, of a value that `loose` gave, or that stood inside one."""
    if not isinstance(value, _Members):
        raise ValueError("not an object")
    first: dict[str, Any] = {}
    again = []
    for key, item in value.items:
        if key in first:
            again.append(key)
        else:
            first[key] = item
    return list(first.items()), again


def loose(raw: bytes) -> Any:
    """Any JSON value, bare NaN and Infinity included; objects come as a private type. Raises ValueError."""
    try:
        # Text, not bytes: of bytes the decoder would guess an encoding, and take a NUL and a digit for a number.
        return json.loads(raw.decode(), object_pairs_hook=_Members)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except ValueError:
        raise ValueError("not JSON") from None


class _Members:
    """A JSON object with its members as written."""

    def __init__(self, items: list[tuple[str, Any]]) -> None:
        self.items = items

    def __repr__(self) -> str:
        return "{...}"


OTHER: Final = -1
BAD: Final = -2


def track_codes(labels: Sequence[str], code: Ints) -> Ints:
    """Track per row of numbered label ids; OTHER for what is no tracked person, BAD for no label id at all."""
    found = np.array([_track_or_code(label) for label in labels], np.int64)
    return found[code] if len(found) else code


def _track_or_code(label: str) -> int:
    try:
        return track_of(label)
    except NotAPersonError:
        return OTHER
    except ValueError:
        return BAD


def record_parts(raw: bytes, frame: str, problems: Problems) -> dict[str, bytes] | None:
    """Raw values of a record by key, first of equal keys; None, with the reason counted, if it is no object."""
    parts: dict[str, bytes] = {}
    try:
        for key, begin, end in members(raw):
            name = loose(key)
            if name in parts:
                problems.add("field", "key twice, the first is kept", frame=frame, field=shorten(name))
            else:
                parts[name] = raw[begin:end]
    except (MalformedError, ValueError):
        problems.add("record", "record is no object", frame=frame, value=raw)
        return None
    return parts


def repaired_label(parts: dict[str, bytes], frame: str, problems: Problems) -> str | None:
    """The record's label id, whether of a person or not; None, with the reason counted, if it has none."""
    raw = parts.get("label_id", b"null")
    try:
        label = loose(raw)
        track_of(label)
    except NotAPersonError:
        pass  # skipped by column, with the others of its kind
    except ValueError as error:
        problems.add("record", str(error), frame=frame, field="label_id", value=raw)
        return None
    return str(label)


def repaired_box(
    parts: dict[str, bytes], frame: str, problems: Problems, kind: str = "record"
) -> tuple[float, float, float, float] | None:
    """The record's 2D box, four numbers; None, with the reason counted, if it has none. `kind`: what is lost then."""
    try:
        box = loose(parts.get("box", b"null"))
        if not isinstance(box, list) or len(box) != 4:
            raise ValueError("not four numbers")
        x, y, w, h = (number(value) for value in box)
    except ValueError as error:
        problems.add(kind, f"box: {error}", frame=frame, field="box", value=parts.get("box", b"missing"))
        return None
    return x, y, w, h


def unpacked(raw: bytes, field: str, frame: str, problems: Problems) -> dict[str, Any]:
    """Members of a sub-object, first of equal keys, repeated ones counted. Raises ValueError if it is no object."""
    items, again = pairs(raw)
    for name in again:
        problems.add("field", "key twice, the first is kept", frame=frame, field=f"{field}.{shorten(name)}")
    return dict(items)
