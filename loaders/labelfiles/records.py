"""Fields of label records: what counts as usable, and what can be used of a record that does not decode as it stands.

Functions that read a field take a decoded JSON value of any type and raise ValueError, with the reason, where it is
unusable. Each layer lists its fields with such functions as `Rules`.
"""

from __future__ import annotations

import contextlib
import functools
import math
import re
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from jrdb_avr.loaders.labelfiles.json import first_members, members, parse
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.labels import plain
from jrdb_avr.schema.things import OBJECTS, PERSON_CATEGORIES

MAX_TRACK: Final = 2**31 - 2
MAX_PIXEL: Final = 1e5
"""No coordinate of a stitched box is as large as this: the panorama has 3760 columns."""
MAX_METRE: Final = 1e4
MAX_TEXT: Final = 100

TWICE: Final = "key twice, the first is kept"

_PERSON: Final = re.compile(r"pedestrian:([0-9]{1,10})")
_WHOLE: Final = re.compile(r"-?[0-9]{1,19}")
_PREFIXED: Final = re.compile(r"([^:]+):-?[0-9]+")
# "Other" may be anything, a person too.
_THINGS: Final = frozenset(
    plain(name)
    for category in set(OBJECTS) - PERSON_CATEGORIES - {"other"}
    for name in (category, *category.split("/"))
)


class NotAPersonError(ValueError):
    """A well-formed label id of something that is certainly no person: its prefix names a category of things."""


def track_of(label_id: object) -> int:
    """The N of `pedestrian:N`. Raises NotAPersonError for a known thing, ValueError for anything else.

    Every other prefix or number may be a person's, badly written.
    """
    if not isinstance(label_id, str):
        raise ValueError("label_id is no text" if label_id is not None else "label_id is missing")
    match = _PERSON.fullmatch(label_id)
    if match and int(match[1]) <= MAX_TRACK:
        return int(match[1])
    if (match := _PREFIXED.fullmatch(label_id)) and plain(match[1]) in _THINGS:
        raise NotAPersonError("label_id is of a thing")
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


def string(value: object) -> str:
    """A text as it stands."""
    if not isinstance(value, str):
        raise ValueError("not a text")
    return value


def difficulty(value: object) -> int:
    """A difficulty code 1..3, also as 1.0 or "1"."""
    return whole(value, 1, 3)


@functools.lru_cache(maxsize=10_000)
def _clean(value: str) -> str:
    return "".join(c if c.isprintable() else " " for c in value).strip()


def text(value: object) -> str:
    """Text that can be stored and printed: no lone surrogates, no control characters, not empty, not endless."""
    clean = _clean(string(value))
    if not clean:
        raise ValueError("empty text")
    if len(clean) > MAX_TEXT:
        raise ValueError("text too long")
    return clean


def numbers(value: object, n: int, count: str) -> list[float]:
    """A list of `n` finite numbers; `count` is `n` in the words of the reason."""
    if not isinstance(value, list) or len(value) != n:
        raise ValueError(f"not {count} numbers")
    return [number(item) for item in value]


def label_id(value: object) -> str:
    """A label id of any kind; which are of tracked people is judged for all records at once."""
    with contextlib.suppress(NotAPersonError):
        track_of(value)
    return str(value)


def box(value: object) -> tuple[float, ...]:
    """A 2D box: x, y, width and height."""
    return tuple(numbers(value, 4, "four"))


# -- records that do not decode ------------------------------------------------------------------------------------


class Rule(NamedTuple):
    """How a field is read where its record does not decode."""

    read: Callable[[Any], Any] | Rules
    """A function of the decoded value; or the rules of a sub-object's members, each of which may be null."""
    costs: str = "field"
    """What is lost where the field cannot be read: `field`, `record`, or `object` for the sub-object it is in."""
    reason: str = ""
    """Begins the reasons for refusing the field."""
    make: Callable[..., Any] = dict
    """Makes the sub-object of its members."""


Rules = Mapping[str, Rule]


def optional(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A function that reads a field which may be missing or null."""
    return lambda value: None if value is None else read(value)


def record_parts(raw: bytes | memoryview, place: str, problems: Problems, kind: str = "") -> dict[str, bytes]:
    """Raw values of an object by key, first of equal keys; `kind` begins the names of its fields.

    Raises MalformedError if it is no object.
    """
    parts: dict[str, bytes] = {}
    for name, value in members(raw, strict=True):
        if name in parts:
            problems.add("field", TWICE, frame=place, field=kind + shorten(name))
        else:
            parts[name] = bytes(value)
    return parts


def read_fields(
    parts: Mapping[str, Any], rules: Rules, place: str, problems: Problems, within: str = ""
) -> dict[str, Any] | None:
    """Usable fields by name; None, with the reason counted, where one is unusable that the record cannot do without.

    `parts` are raw values, or decoded members of a sub-object, which raises ValueError instead; `within` begins the
    names of fields in the report.
    """
    values: dict[str, Any] = {}
    for name, rule in rules.items():
        part = parts.get(name)
        try:
            value = parse(part) if isinstance(part, bytes) else part
            if callable(rule.read):
                values[name] = rule.read(value)
            elif value is not None or rule.costs == "record":
                inner, again = first_members(value)
                for key in again:
                    problems.add("field", TWICE, frame=place, field=f"{name}.{shorten(key)}")
                values[name] = rule.make(**read_fields(inner, rule.read, place, problems, f"{name}.") or {})
        except ValueError as error:
            if rule.costs == "object":
                raise ValueError(f"{name}: {error}") from None
            shown = b"missing" if part is None else part
            problems.add(rule.costs, f"{rule.reason}{error}", frame=place, field=within + name, value=shown)
            if rule.costs == "record":
                return None
    return values
