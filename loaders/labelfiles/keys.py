"""How often keys are written in a JSON text, told from the bytes before its colons.

Where a record repeats a key, its text holds more keys than decoding gave. Searching the text for every key would take
as long as decoding it; here the text is read once, and the eight bytes before each colon are compared with the keys.
"""

from __future__ import annotations

import functools
from typing import Final

import numpy as np
import numpy.typing as npt

SHORT: Final = 4096
"""A text shorter than this, such as one record, is faster searched for every key than for its colons."""
_WIDTH: Final = 8
_COLON: Final = ord(":")
_SHORTEST: Final = 5
"""Bytes of the shortest member of an object, `"":1,`. Where there are more colons, strings are full of them: an ending
of each would take many times the memory of the text."""
_FIRST_INK: Final = np.uint64((ord(" ") + 1) << 56)
"""Endings from here on have no blank for their last byte."""


class WrittenKeys:
    """The keys of a text. None of them may be written with escapes."""

    def __init__(self, text: bytes) -> None:
        self._text = text
        self._endings = _endings(text)

    def exceed(self, limit: int, *keys: bytes) -> bool:
        """Whether `keys` (ASCII, in quotes) stand in the text more than `limit` times, all together.

        A string with the text of a key may count for one, but no key is missed.
        """
        # Other keys can end as one of these does, so only few endings prove anything.
        return self._ending_as(keys) > limit and sum(map(self._text.count, keys)) > limit

    def _ending_as(self, keys: tuple[bytes, ...]) -> int:
        if self._endings is None:
            return sum(map(self._text.count, keys))
        # What stands before a colon among the first eight bytes has no whole ending.
        found = sum(map(self._text[: _WIDTH - 1].count, keys))
        for key in keys:
            ending, shift = _number_of(key)
            endings = self._endings >> shift if shift else self._endings
            found += int(np.count_nonzero(endings == ending))
        return found


def _endings(text: bytes) -> npt.NDArray[np.uint64] | None:
    """The eight bytes before each colon as a number, its last byte the highest; None where that tells no keys."""
    if len(text) < SHORT:
        return None
    found = np.frombuffer(text, np.uint8) == _COLON
    if np.count_nonzero(found) > len(text) // _SHORTEST:
        return None
    colons = np.flatnonzero(found)
    colons = colons[np.searchsorted(colons, _WIDTH) :]
    before: npt.NDArray[np.uint64] = np.ndarray((len(text) - _WIDTH + 1,), "<u8", text, 0, (1,))
    endings = before[colons - _WIDTH]
    blank = len(endings) and endings.min() < _FIRST_INK
    return None if blank else endings


@functools.cache
def _number_of(key: bytes) -> tuple[np.uint64, np.uint64]:
    """The ending of a key as a number, and how far endings are shifted to be compared with it."""
    ending = key[-_WIDTH:]
    return np.uint64(int.from_bytes(ending, "little")), np.uint64(8 * (_WIDTH - len(ending)))
