"""Bins of answers that are times or numbers, and of the waits that a question states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jrdb_avr.schema.answer_modes import MODES, decode_answer, frames_of_answer
from jrdb_avr.schema.answers import Number
from jrdb_avr.schema.rules import FPS, frames


def wait_bin(wait: int) -> int:
    """Bin of a wait in frames: 0 below 3 s, then [3, 6), [6, 12), [12, 24), ... seconds."""
    return int(np.floor(np.log2(wait / frames(3.0)))) + 1 if wait >= frames(3.0) else 0


def answer_bin(mode: str, answer: str, times: Sequence[int], read: str) -> int:
    """Bin of a stored answer: of an event's offset from the first stated time, or of a gap's seconds; a count is its
    own."""
    stored, edges = decode_answer(mode, answer), MODES[mode].bin_edges_s
    if frames := frames_of_answer(stored):
        return int(np.searchsorted(edges, (frames[0] - times[0]) / FPS, side="right"))
    if isinstance(stored, Number):
        return int(stored.value) if read == "count" else int(np.searchsorted(edges, stored.value, side="right"))
    return 0


def bin_name(mode: str, read: str, number: int) -> str:
    """What a bin of `answer_bin` holds: a range of seconds, or a count.

    >>> bin_name("frame", "start", 2)
    '[6, 10)'
    """
    if read == "count":
        return str(number)
    edges = (0.0, *MODES[mode].bin_edges_s)
    above = f"{edges[number + 1]:g}" if number + 1 < len(edges) else "inf"
    return f"[{edges[number]:g}, {above})"
