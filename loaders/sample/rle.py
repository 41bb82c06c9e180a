"""Run-length codes of the segments of a picture, in the compressed text of COCO files.

Counts go down the columns, left to right, and begin with the pixels before the first run. From the third on, the
difference from the count two before is written, five bits per character, lowest first; the sixth bit says that more
follow, and the highest of the last five is the sign.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from jrdb_avr.schema.arrays import Ints


class Segment(NamedTuple):
    """One segment's id in the picture, its code, pixels, and box (x, y, w, h)."""

    id: int
    counts: str
    area: int
    box: tuple[int, int, int, int]


def segments_of(picture: npt.NDArray[np.uint16]) -> list[Segment]:
    """Every segment of a picture (rows, columns) of ids, by id; 0 is no segment."""
    height = picture.shape[0]
    flat = np.ascontiguousarray(picture.T).ravel()
    first = np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1]) + 1])
    length = np.diff(np.append(first, len(flat)))
    ids = flat[first].astype(np.int64)
    order = np.argsort(ids, kind="stable")
    ids, first, length = ids[order], first[order], length[order]
    starts = np.flatnonzero(np.concatenate([[True], ids[1:] != ids[:-1]]))
    ends = np.append(starts[1:], len(ids))
    # Of each run, the pixels before it since the run before, then its own.
    before = first.copy()
    before[1:] -= (first + length)[:-1]
    before[starts] = first[starts]
    pairs = np.stack([before, length], axis=1)
    last = first + length
    tail = len(flat) - last[ends - 1]
    top, bottom = first % height, (last - 1) % height
    # A run that goes on in the next column fills a column's end and the next one's begin.
    crosses = first // height != (last - 1) // height
    top, bottom = np.where(crosses, 0, top), np.where(crosses, height - 1, bottom)
    out = []
    for start, end, rest in zip(starts.tolist(), ends.tolist(), tail.tolist(), strict=True):
        if ids[start] == 0:
            continue
        counts = pairs[start:end].ravel()
        if rest:
            counts = np.append(counts, rest)
        x = int(first[start] // height)
        y = int(top[start:end].min())
        right, low = int((last[end - 1] - 1) // height), int(bottom[start:end].max())
        box = (x, y, right - x + 1, low - y + 1)
        out.append(Segment(int(ids[start]), compressed(counts), int(length[start:end].sum()), box))
    return out


def compressed(counts: Ints) -> str:
    """The text of run lengths."""
    values = counts.astype(np.int64).copy()
    values[3:] -= counts[1:-2]
    digits = []
    more = []
    rest = values
    # Six times five bits hold any count of a panorama.
    for _ in range(6):
        digit = rest & 31
        rest = rest >> 5
        ended = np.where(digit & 16, rest == -1, rest == 0)
        digits.append(digit)
        more.append(~ended)
    digit_table = np.stack(digits, axis=1)
    more_table = np.stack(more, axis=1)
    # A character is written while all before it said that more follow.
    written = np.ones_like(more_table)
    written[:, 1:] = np.logical_and.accumulate(more_table[:, :-1], axis=1)
    text = (digit_table | np.where(more_table, 32, 0)) + 48
    return bytes(text[written].astype(np.uint8)).decode("ascii")
