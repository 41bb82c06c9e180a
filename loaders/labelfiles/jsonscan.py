"""A scanner that finds where the members of JSON objects and arrays begin and end, without decoding them.

The fast paths take strict JSON of the usual layout. When a file is not that (a bare NaN, a repeated key, a text cut
short), this scanner cuts it into frames and records, so that each is judged alone. It checks the structure it walks
over, not the scalars inside.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

_TOKEN: Final = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"|["\[\]{}]', re.DOTALL)
_STRING: Final = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"', re.DOTALL)
_SPACE: Final = re.compile(rb"[ \t\r\n]*")
_SCALAR: Final = re.compile(rb"[^,\[\]{}\s\"]+")
_OPEN: Final = b"[{"


class MalformedError(ValueError):
    """The text is not JSON in structure: most often it ends too early."""


def members(data: bytes, start: int = 0) -> Iterator[tuple[bytes, int, int]]:
    """The members of the object that begins at `start` (after blanks): key in quotes, start and end of the value.

    Raises MalformedError where the structure breaks, possibly after some members were yielded.
    """
    position = _blank(data, start)
    if data[position : position + 1] != b"{":
        raise MalformedError("not an object")
    position = _blank(data, position + 1)
    if data[position : position + 1] == b"}":
        return
    while True:
        key = _STRING.match(data, position)
        if key is None:
            raise MalformedError("a key is missing")
        position = _blank(data, key.end())
        if data[position : position + 1] != b":":
            raise MalformedError("a colon is missing")
        begin = _blank(data, position + 1)
        end = _value_end(data, begin)
        yield key.group(), begin, end
        position = _next(data, end, b"}")
        if position < 0:
            return


def elements(data: bytes, start: int = 0) -> Iterator[tuple[int, int]]:
    """Start and end of each element of the array that begins at `start` (after blanks). Raises MalformedError."""
    position = _blank(data, start)
    if data[position : position + 1] != b"[":
        raise MalformedError("not a list")
    position = _blank(data, position + 1)
    if data[position : position + 1] == b"]":
        return
    while True:
        end = _value_end(data, position)
        yield position, end
        position = _next(data, end, b"]")
        if position < 0:
            return


def end_of_text(data: bytes, last: int) -> bool:
    """Whether nothing but the closing bracket of an object follows its last member, which ends at `last`."""
    position = _blank(data, last)
    # An object without members has its opening bracket still before it.
    if data[position : position + 1] == b"{":
        position = _blank(data, position + 1)
    return data[position : position + 1] == b"}" and _blank(data, position + 1) == len(data)


def _blank(data: bytes, position: int) -> int:
    match = _SPACE.match(data, position)
    return match.end() if match else position


def _next(data: bytes, position: int, closing: bytes) -> int:
    """Start of the next member after a comma, or -1 at the closing bracket."""
    position = _blank(data, position)
    mark = data[position : position + 1]
    if mark == closing:
        return -1
    if mark != b",":
        raise MalformedError("the text ends early" if not mark else "a comma is missing")
    return _blank(data, position + 1)


def _value_end(data: bytes, start: int) -> int:
    first = data[start : start + 1]
    if not first:
        raise MalformedError("the text ends early")
    if first not in (b"[", b"{"):
        scalar = (_STRING if first == b'"' else _SCALAR).match(data, start)
        if scalar is None:
            raise MalformedError("a value is missing")
        return scalar.end()
    depth = 0
    for token in _TOKEN.finditer(data, start):
        mark = token.group()
        if len(mark) > 1:
            continue
        if mark == b'"':
            raise MalformedError("a string does not end")
        depth += 1 if mark in _OPEN else -1
        if depth == 0:
            return token.end()
    raise MalformedError("the text ends early")
