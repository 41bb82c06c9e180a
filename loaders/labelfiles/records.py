"""Functions that convert single JSON values of label records into values of the tables.

Each `read_` function takes a decoded value and returns the value to store. It raises ValueError with the reason if the
value is unusable.
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
"""Maximum track or category id."""
MAX_PIXEL: Final = 1e5
"""Maximum absolute coordinate or size of a stitched 2D box in pixels. The panorama is 3760 pixels wide."""
MAX_METRE: Final = 1e4
"""Maximum absolute coordinate, size or distance of a 3D box in metres."""
MAX_TEXT: Final = 100
"""Maximum characters of a label."""

BROKEN: Final = (msgspec.DecodeError, RecursionError, UnicodeError)
"""Errors that msgspec raises if it cannot decode a text."""
ABSENT: Final = (b"", b"null")
"""Raw values of a missing field. A null is treated like a missing key."""
NOTHING: Final = msgspec.Raw(b"")
"""Default of raw fields: the raw value of a missing key."""

_PERSON: Final = re.compile(r"pedestrian:([0-9]{1,10})")
_WHOLE: Final = re.compile(r"-?[0-9]{1,19}")
_PREFIXED: Final = re.compile(r"([^:]+):-?[0-9]+")
# A thing of the category "other" may be a person, so this category is left out.
_THINGS: Final = frozenset(
    plain(name)
    for category in set(OBJECTS) - PERSON_CATEGORIES - {"other"}
    for name in (category, *category.split("/"))
)


class NotAPersonError(ValueError):
    """Error for a well-formed label id of a thing, such as `car:3`."""


def parse(raw: bytes | msgspec.Raw) -> Any:
    """Decode a JSON value.

    Raises:
        ValueError: If the value is not JSON or is nested too deeply.
    """
    try:
        return msgspec.json.decode(raw)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except BROKEN:
        raise ValueError("not JSON") from None


def read_track(label_id: str) -> int:
    """Return the track N of a person's label id, which has the form `pedestrian:N`.

    Raises:
        NotAPersonError: If the text before the colon is a category of things.
        ValueError: If the label id is neither of a person nor of a thing. It may be a misspelt label id of a person.
    """
    match = _PERSON.fullmatch(label_id)
    if match and int(match[1]) <= MAX_TRACK:
        return int(match[1])
    if (match := _PREFIXED.fullmatch(label_id)) and plain(match[1]) in _THINGS:
        raise NotAPersonError("label_id is of a thing")
    raise ValueError("label_id is not pedestrian:N")


def read_number(value: object) -> float:
    """Return a finite number as a float. Raise ValueError for any other value. A bool is not a number here."""
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
    """Return a whole number from `low` to `high`, both included. Values such as 7.0 and "7" are accepted."""
    if isinstance(value, str) and _WHOLE.fullmatch(value):
        value = int(value)
    result = read_number(value)
    if result != math.floor(result):
        raise ValueError("not a whole number")
    # An int above 2**53 would lose digits as a float.
    exact = value if isinstance(value, int) else int(result)
    if not low <= exact <= high:
        raise ValueError("number out of range")
    return exact


def read_flag(value: object) -> bool:
    """Return a bool. The strings "true" and "false" are accepted in upper or lower case."""
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.lower() in ("true", "false"):
        return value.lower() == "true"
    raise ValueError("neither true nor false")


def read_difficulty(value: object) -> int:
    """Return a difficulty code: 1, 2 or 3. Values such as 1.0 and "1" are accepted."""
    return read_whole(value, 1, 3)


@functools.lru_cache(maxsize=10_000)
def read_text(value: str) -> str:
    """Return a text with blanks instead of unprintable characters, and without blanks at its ends.

    Raise ValueError if the resulting text is empty or too long.
    """
    clean = "".join(c if c.isprintable() else " " for c in value).strip()
    if not clean:
        raise ValueError("empty text")
    if len(clean) > MAX_TEXT:
        raise ValueError("text too long")
    return clean
