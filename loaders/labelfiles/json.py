"""JSON texts that strict decoding refuses or loses parts of, cut into raw parts by a scanner.

Strict decoding keeps the last of repeated keys and refuses a file for one bare NaN. So its result is only taken where
it covers the whole text; any other text (repeated keys, a NaN, a file cut short) is cut by the scanner, which checks
the structure it walks over and not the scalars inside. Each part is then judged alone. The scanner's memory does not
depend on the number of members.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterable, Iterator
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt

BROKEN: Final = (msgspec.DecodeError, RecursionError, UnicodeError)
"""What strict decoding raises."""

ABSENT: Final = (b"", b"null")
"""Raw values of a key that is not there: a null says no more than a missing key."""

NOTHING: Final = msgspec.Raw(b"")
"""Default of raw fields."""

_BLANK: Final = rb"[ \t\r\n]*"
_STRING: Final = rb'"[^"\\]*(?:\\.[^"\\]*)*"'
_MARK: Final = re.compile(_BLANK + rb"(.?)" + _BLANK, re.DOTALL)
_KEY: Final = re.compile(rb"(" + _STRING + rb")" + _BLANK + rb":" + _BLANK, re.DOTALL)
_SCALAR: Final = re.compile(_STRING + rb'|[^,\[\]{}\s"]+', re.DOTALL)
_TOKEN: Final = re.compile(_STRING + rb'|["\[\]{}]', re.DOTALL)


class MalformedError(ValueError):
    """The text is not JSON in structure: most often it ends too early."""


def members(text: bytes | memoryview, strict: bool = False) -> Iterator[tuple[str, memoryview]]:
    """Keys and raw values of an object, repeated keys included.

    strict: a key that is no JSON text breaks the object. Raises MalformedError where the structure breaks, possibly
    after some members were yielded.
    """
    for key, value in _scan(text, b"{", b"}"):
        try:
            name = msgspec.json.decode(key, type=str)
        except BROKEN:
            if strict:
                raise MalformedError("a key is no text") from None
            name = key.decode("utf-8", "replace")
        yield name, value


def elements(text: bytes | memoryview) -> Iterator[memoryview]:
    """The raw elements of a list. Raises MalformedError as `members`."""
    return (value for _, value in _scan(text, b"[", b"]"))


def _scan(text: bytes | memoryview, opening: bytes, closing: bytes) -> Iterator[tuple[bytes, memoryview]]:
    """The members of an object (quoted key, value) or the elements of a list (no key, value)."""
    text = memoryview(text)
    mark = _match(_MARK, text, 0)
    if mark[1] != opening:
        raise MalformedError("not an object" if opening == b"{" else "not a list")
    position, key = mark.end(), b""
    ends = text[position : position + 1] == closing
    position += ends
    while not ends:
        if opening == b"{":
            named = _KEY.match(text, position)
            if named is None:
                raise MalformedError("a key with its colon is missing")
            key, position = named[1], named.end()
        end = _value_end(text, position)
        yield key, text[position:end]
        mark = _match(_MARK, text, end)
        ends, position = mark[1] == closing, mark.end()
        if not ends and mark[1] != b",":
            raise MalformedError("a comma is missing" if mark[1] else "the text ends early")
    if _match(_MARK, text, position)[1]:
        raise MalformedError("there is text after its end")


def _match(form: re.Pattern[bytes], text: memoryview, position: int) -> re.Match[bytes]:
    match = form.match(text, position)
    assert match is not None
    return match


def _value_end(text: memoryview, start: int) -> int:
    first = bytes(text[start : start + 1])
    if first not in (b"[", b"{"):
        scalar = _SCALAR.match(text, start)
        if scalar is None:
            raise MalformedError("a value is missing" if first else "the text ends early")
        return scalar.end()
    depth = 0
    for token in _TOKEN.finditer(text, start):
        mark = token[0]
        if mark == b'"':
            raise MalformedError("a string does not end")
        depth += (mark in b"[{") - (mark in b"]}")
        if depth == 0:
            return token.end()
    raise MalformedError("the text ends early")


# -- values --------------------------------------------------------------------------------------------------------


class Members(dict[str, Any]):
    """A JSON object: the first of equal keys, and the keys that stood there again."""

    def __init__(self, items: list[tuple[str, Any]]) -> None:
        super().__init__(items)
        self.again: list[str] = []
        if len(self) < len(items):
            self.clear()
            for key, item in items:
                if key in self:
                    self.again.append(key)
                self.setdefault(key, item)

    def __repr__(self) -> str:
        return "{...}"


_ANY: Final = json.JSONDecoder(object_pairs_hook=Members)


def parse(raw: bytes | memoryview) -> Any:
    """Any JSON value, bare NaN and Infinity included; objects are `Members`. Raises ValueError."""
    try:
        # Text, not bytes: of bytes the decoder would guess an encoding, and take a NUL and a digit for a number.
        return _ANY.decode(str(raw, "utf-8"))
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except ValueError:
        raise ValueError("not JSON") from None


def first_members(value: object) -> tuple[dict[str, Any], list[str]]:
    """The members of a parsed object, first of equal keys, and the keys that stood there again. Raises ValueError."""
    if not isinstance(value, Members):
        raise ValueError("not an object")
    return value, value.again


def parse_members(raw: bytes) -> tuple[dict[str, Any], list[str]]:
    """As `first_members`, of a raw object. Raises ValueError."""
    try:
        quick = msgspec.json.decode(raw)
    except BROKEN:
        quick = None
    # A colon for each key and no other: none is repeated.
    if isinstance(quick, dict) and len(quick) == raw.count(b":"):
        return quick, []
    return first_members(parse(raw))


# -- repeated keys -------------------------------------------------------------------------------------------------

_WIDTH: Final = 8
_SHORT: Final = 4096
"""A text shorter than this, such as one record, is faster searched for every key than for its colons."""
_SHORTEST: Final = 5
"""Bytes of the shortest member of an object, `"":1,`. Where there are more colons, strings are full of them."""
_FIRST_INK: Final = np.uint64((ord(" ") + 1) << 56)
"""Endings from here on have no blank for their last byte."""


Limit = tuple[int, tuple[bytes, ...]]
"""How often keys may stand in a text, all together."""


def keys_exceed(text: bytes, limits: Iterable[Limit]) -> bool:
    """Whether keys (ASCII, in quotes) stand in a text more often than their limit, those of one limit all together.

    Decoding keeps one of repeated keys: then the text holds more keys than were decoded. Searching for every key would
    take as long as decoding, so the text is read once, and the eight bytes before each colon are compared with the
    keys. A string with the text of a key may count for one, but no key is missed where none is written with escapes.
    """
    endings = _endings(text)
    for limit, keys in limits:
        # Other keys can end as one of these does, so only few endings prove anything.
        few = endings is not None and sum(_ending_as(endings, key) for key in keys) <= limit
        if not few and sum(map(text.count, keys)) > limit:
            return True
    return False


def _endings(text: bytes) -> npt.NDArray[np.uint64] | None:
    """The eight bytes before each colon as a number, its last byte the highest; None where that tells no keys."""
    colons = np.frombuffer(text, np.uint8) == ord(":")
    if len(text) < _SHORT or np.count_nonzero(colons) > len(text) // _SHORTEST:
        return None
    if colons[:_WIDTH].any():
        return _endings(b" " * _WIDTH + text)
    before: npt.NDArray[np.uint64] = np.ndarray((len(text) - _WIDTH,), "<u8", text, 0, (1,))
    endings = before[colons[_WIDTH:]]
    return None if len(endings) and endings.min() < _FIRST_INK else endings


def _ending_as(endings: npt.NDArray[np.uint64], key: bytes) -> int:
    ending, shift = _ending_of(key)
    return int(np.count_nonzero((endings >> shift if shift else endings) == ending))


@functools.cache
def _ending_of(key: bytes) -> tuple[np.uint64, np.uint64]:
    """The ending of a key as a number, and how far endings are shifted to be compared with it."""
    ending = key[-_WIDTH:]
    return np.uint64(int.from_bytes(ending, "little")), np.uint64(8 * (_WIDTH - len(ending)))
