"""Bins of answers that are times or numbers, and of the waits that a question states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from jrdb_avr.schema.answers import FrameAnswer, FrameViewpoint, Number, Span, decode_answer
from jrdb_avr.schema.rules import FPS, frames

OFFSET_EDGES_S: Final = (3.0, 6.0, 10.0, 15.0, 21.0)
GAP_EDGES_S: Final = (5.0, 10.0, 20.0, 40.0)


def wait_bin(wait: int) -> int:
    """Bin of a wait in frames: 0 below 3 s, then [3, 6), [6, 12), [12, 24), ... seconds."""
    return int(np.floor(np.log2(wait / frames(3.0)))) + 1 if wait >= frames(3.0) else 0


def answer_bin(mode: str, answer: str, times: Sequence[int], read: str) -> int:
    """Bin of a stored answer: of an event's offset from the first stated time, or of a gap's seconds; a count is its
    own."""
    match decode_answer(mode, answer):
        case FrameAnswer(frame) | FrameViewpoint(frame) | Span(frame):
            return int(np.searchsorted(OFFSET_EDGES_S, (frame - times[0]) / FPS, side="right"))
        case Number(value):
            return int(value) if read == "count" else int(np.searchsorted(GAP_EDGES_S, value, side="right"))
    return 0


def bin_name(mode: str, read: str, number: int) -> str:
    """What a bin of `answer_bin` holds: a range of seconds, or a count.

    >>> bin_name("frame", "start", 2)
    '[6, 10)'
    """
    if read == "count":
        return str(number)
    edges = (0.0, *(GAP_EDGES_S if mode == "number" else OFFSET_EDGES_S))
    above = f"{edges[number + 1]:g}" if number + 1 < len(edges) else "inf"
    return f"[{edges[number]:g}, {above})"
