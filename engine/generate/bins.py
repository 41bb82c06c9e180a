"""Bins of answers that are times or numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jrdb_avr.schema.answer_modes import MODES, decode_answer, frames_of_answer
from jrdb_avr.schema.answers import Number
from jrdb_avr.schema.rules import FPS


def answer_bin(mode: str, answer: str, times: Sequence[int], read: str) -> int:
    """Return the bin of a stored answer.

    Args:
        mode: Answer mode.
        answer: JSON of the answer.
        times: Stated frames.
        read: Kind of value that the answer reads.

    Returns:
        The number of the bin: of an event's offset from the first stated time, or of seconds. A count is its own bin.
    """
    stored, edges = decode_answer(mode, answer), MODES[mode].bin_edges_s
    if frames := frames_of_answer(stored):
        return int(np.searchsorted(edges, (frames[0] - times[0]) / FPS, side="right"))
    if isinstance(stored, Number):
        return int(stored.value) if read == "count" else int(np.searchsorted(edges, stored.value, side="right"))
    return 0


def bin_name(mode: str, read: str, number: int) -> str:
    """Return the range of seconds, or the count, of a bin.

    Args:
        mode: Answer mode.
        read: Kind of value that the answer reads.
        number: Result of `answer_bin`.

    Returns:
        The text of the range.

    >>> bin_name("frame", "start", 2)
    '[6, 10)'
    """
    if read == "count":
        return str(number)
    edges = (0.0, *MODES[mode].bin_edges_s)
    above = f"{edges[number + 1]:g}" if number + 1 < len(edges) else "inf"
    return f"[{edges[number]:g}, {above})"
