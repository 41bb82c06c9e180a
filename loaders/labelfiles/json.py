"""The frames of a label file that is laid out as such files are, one after another, without the file in memory.

A file is read window by window. What stands between two frame keys is taken for a frame's value if it is one whole
JSON value by msgspec's own reading and a comma follows: a text has no two readings, so nothing else can begin there.
Any other layout (a bare NaN, a second `labels`, keys of another form) is left to the scanner in `jsonscan`: the frames
found until then are those that the scanner finds first.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import BinaryIO, Final, TypeVar

import msgspec

WINDOW: Final = 8 << 20
MAX_VALUE: Final = 64 << 20
"""Bytes of one frame at most, sixteen times as many as are read of one: memory is bounded by it."""

_OPENING: Final = re.compile(rb'(?:\xef\xbb\xbf)?[ \t\r\n]*\{[ \t\r\n]*"labels"[ \t\r\n]*:[ \t\r\n]*\{[ \t\r\n]*')
_KEY: Final = re.compile(rb'"[0-9]{6}(\.[a-z]{3,4})"[ \t\r\n]*:')
_NUMBER: Final = '"000000'
"""What stands before the suffix of a key."""
_LONGEST: Final = 64
"""Bytes of a key with its colon that may be cut by the end of a window; with more blanks it is not found."""
_BLANKS: Final = b" \t\r\n"
_ANYTHING: Final = msgspec.json.Decoder(msgspec.Raw)
_BROKEN: Final = (msgspec.DecodeError, RecursionError, UnicodeError)

T = TypeVar("T")


class OtherLayoutError(ValueError):
    """The rest of a file is not laid out as usual, or is not UTF-8 or JSON."""


def frame_texts(file: BinaryIO, decode: Callable[[bytes], T | None]) -> Iterator[tuple[str, bytes, T | None]]:
    """Key and text of each frame of a file at its beginning, and what `decode` makes of the text: None where it is not
    one JSON value of the form expected, which is then looked at more loosely.

    Raises OtherLayoutError where the layout is another, possibly after frames were yielded, and OSError where the file
    cannot be read.
    """
    text = file.read(WINDOW)
    opening = _OPENING.match(text)
    key = _KEY.match(text, opening.end()) if opening else None
    if key is None:
        raise OtherLayoutError
    # Keys are looked for by the suffix of the first: a literal beginning makes the search many times as fast.
    suffix = re.escape(key[1])
    later = re.compile(suffix + rb'(?<="[0-9]{6}' + suffix + rb')"[ \t\r\n]*:')
    name = _name(text, key.start(1), key.end(1))
    begin = search = key.end()
    while True:
        following = later.search(text, search)
        if following is None:
            more = file.read(WINDOW)
            if more:
                if len(text) - begin > MAX_VALUE:
                    raise OtherLayoutError
                text, search = text[begin:] + more, max(0, len(text) - begin - _LONGEST)
                begin = 0
                continue
            value = _last(text[begin:])
        else:
            value = _before(text[begin : following.start() - len(_NUMBER)], b",")
        if value is None or not _is_utf8(value):
            raise OtherLayoutError
        decoded = decode(value)
        if decoded is None and not _is_json(value):
            raise OtherLayoutError
        yield name, value, decoded
        if following is None:
            return
        name = _name(text, following.start(), following.start() + len(key[1]))
        begin = search = following.end()


def _is_utf8(value: bytes) -> bool:
    try:
        return value.isascii() or bool(value.decode())
    except UnicodeError:
        return False


def _is_json(value: bytes) -> bool:
    """Whether a text is one whole JSON value."""
    try:
        _ANYTHING.decode(value)
    except _BROKEN:
        return False
    return True


def _name(text: bytes, start: int, end: int) -> str:
    """The key whose suffix stands from `start` to `end`."""
    return text[start - len(_NUMBER) + 1 : end].decode()


def _before(text: bytes, mark: bytes) -> bytes | None:
    """What stands before the mark that the text ends with, blanks aside; None where it ends otherwise."""
    text = text.rstrip(_BLANKS)
    return text[: -len(mark)].rstrip(_BLANKS) if text.endswith(mark) else None


def _last(text: bytes) -> bytes | None:
    """What stands before the two brackets that end a file."""
    inner = _before(text, b"}")
    return None if inner is None else _before(inner, b"}")
