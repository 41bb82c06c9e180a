"""Whole panoramas as a method's fixed context: which frames, the pictures, and the lines that announce them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from jrdb_avr.schema.method import Panorama

from .messages import Part, Picture

PANORAMAS: Final = 8
"""Panoramas shown by the methods that cannot choose where to look."""

UNIFORM: Final = "evenly spaced by position among the legal ones, first and last included"
"""What `uniform_frames` does, in the words of a run's manifest."""


def uniform_frames(frames: Sequence[int], n: int = PANORAMAS) -> tuple[int, ...]:
    """`n` of the ascending legal `frames`, evenly spaced by position among them; all where there are no more than `n`.

    Of m frames the i-th (from 0) is the one at position i * (m - 1) / (n - 1), rounded to the nearest, halves up: the
    first and the last are always among them, and no frame comes twice. n = 1 gives the one in the middle, the earlier
    of two.

    >>> uniform_frames(range(0, 100, 5), 4)
    (0, 30, 65, 95)
    """
    if n < 1:
        raise ValueError("a fixed context holds one panorama at least")
    if len(frames) <= n:
        return tuple(frames)
    last = len(frames) - 1
    if n == 1:
        return (frames[last // 2],)
    # Steps are longer than one position, so that rounding never meets the same frame twice.
    return tuple(frames[(2 * i * last + n - 1) // (2 * (n - 1))] for i in range(n))


def panorama_picture(panorama: Panorama) -> Picture:
    """The panorama as it is stored: its file's bytes, not encoded anew."""
    return Picture(f"{panorama.sequence} {panorama.frame_id} panorama", panorama.jpeg)


def panorama_metadata(panorama: Panorama) -> dict[str, Any]:
    """What a model is told of a panorama: frame id, and seconds from frame 0."""
    return {"frame_id": panorama.frame_id, "timestamp": round(panorama.timestamp, 3)}


def panorama_line(panorama: Panorama) -> str:
    """`panorama_metadata` as JSON on one line."""
    return msgspec.json.encode(panorama_metadata(panorama)).decode()


def panorama_parts(panoramas: Sequence[Panorama]) -> tuple[Part, ...]:
    """Each panorama behind the line that numbers and places it."""
    return tuple(
        part
        for number, panorama in enumerate(panoramas, 1)
        for part in (f"Panorama {number}: {panorama_line(panorama)}", panorama_picture(panorama))
    )


def frame_list(panoramas: Sequence[Panorama]) -> str:
    """The frame ids of panoramas, with commas between."""
    return ", ".join(panorama.frame_id for panorama in panoramas)


def fixed_settings(n: int) -> dict[str, Any]:
    """What a run's manifest says of a fixed context of `n` panoramas."""
    return {"panoramas": n, "frames": UNIFORM}
