"""Readers of single JSON values of label records.

Each function takes a decoded value of any type and returns what can be stored. It raises ValueError with the reason if
the value is unusable.
"""

from __future__ import annotations

import functools
import math
import re
from typing import Any, Final

import msgspec

from jrdb_avr.schema.labels import plain
from jrdb_avr.schema.things import OBJECTS, PERSON_CATEGORIES

MAX_TRACK: Final = 2**31 - 2
MAX_PIXEL: Final = 1e5
"""Maximum coordinate of a stitched 2D box in pixels. The panorama has 3760 columns."""
MAX_METRE: Final = 1e4
MAX_TEXT: Final = 100
"""Maximum characters of a label."""

BROKEN: Final = (msgspec.DecodeError, RecursionError, UnicodeError)
"""Errors that msgspec raises for text that does not decode."""
ABSENT: Final = (b"", b"null")
"""Raw values of a missing key. A null says no more than a missing key."""
NOTHING: Final = msgspec.Raw(b"")
"""Default of raw fields."""

_PERSON: Final = re.compile(r"pedestrian:([0-9]{1,10})")
_WHOLE: Final = re.compile(r"-?[0-9]{1,19}")
_PREFIXED: Final = re.compile(r"([^:]+):-?[0-9]+")
# The category "other" may be anything, also a person.
_THINGS: Final = frozenset(
    plain(name)
    for category in set(OBJECTS) - PERSON_CATEGORIES - {"other"}
    for name in (category, *category.split("/"))
)


class NotAPersonError(ValueError):
    """A well-formed label id with the prefix of a category of things."""


def parse(raw: bytes | msgspec.Raw) -> Any:
    """Return a decoded JSON value. Raises ValueError."""
    try:
        return msgspec.json.decode(raw)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except BROKEN:
        raise ValueError("not JSON") from None


def read_track(label_id: str) -> int:
    """Return the N of `pedestrian:N`.

    Any unknown prefix or number may be a badly written person.

    Raises:
        NotAPersonError: the prefix is a category of things.
        ValueError: anything else.
    """
    match = _PERSON.fullmatch(label_id)
    if match and int(match[1]) <= MAX_TRACK:
        return int(match[1])
    if (match := _PREFIXED.fullmatch(label_id)) and plain(match[1]) in _THINGS:
        raise NotAPersonError("label_id is of a thing")
    raise ValueError("label_id is not pedestrian:N")


def read_number(value: object) -> float:
    """Return a finite number. A bool is refused."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("not a number")
    try:
        result = float(value)
    except OverflowError:
        raise ValueError("number too large") from None
    if not math.isfinite(result):
        raise ValueError("not a finite number")
    return result


def read_whole(value: object, low: int, high: int) -> int:
    """Return a whole number in [low, high], also from 7.0 or "7"."""
    if isinstance(value, str) and _WHOLE.fullmatch(value):
        value = int(value)
    result = read_number(value)
    if result != math.floor(result):
        raise ValueError("not a whole number")
    # An int beyond 2**53 would lose digits as a float.
    exact = value if isinstance(value, int) else int(result)
    if not low <= exact <= high:
        raise ValueError("number out of range")
    return exact


def read_flag(value: object) -> bool:
    """Return a bool, also from "true" or "false" in any case."""
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.lower() in ("true", "false"):
        return value.lower() == "true"
    raise ValueError("neither true nor false")


def read_difficulty(value: object) -> int:
    """Return a difficulty code 1..3, also from 1.0 or "1"."""
    return read_whole(value, 1, 3)


@functools.lru_cache(maxsize=10_000)
def read_text(value: str) -> str:
    """Return printable text of 1 to MAX_TEXT characters, without surrogates and control characters."""
    clean = "".join(c if c.isprintable() else " " for c in value).strip()
    if not clean:
        raise ValueError("empty text")
    if len(clean) > MAX_TEXT:
        raise ValueError("text too long")
    return clean
