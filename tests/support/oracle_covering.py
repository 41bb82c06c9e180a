"""Share of each box that nearer boxes hide, by counting the cells of a grid.

It shares no code with what it checks. Lengths are whole numbers of 1/256 pixel.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import numpy as np

PIXEL = 256
TURN = 3760 * PIXEL


def corners(x, y, w, h):
    """Left, right, top and bottom; cut to the picture's 480 rows, and to one turn."""
    left, right = round(x * PIXEL), round((x + w) * PIXEL)
    rows = [min(max(round(row * PIXEL), 0), 480 * PIXEL) for row in (y, y + h)]
    return left, left + min(right - left, TURN), *rows


def nearer(one, other):
    """Whether the second box is nearer: its feet are lower, or its head is higher if both have no feet."""
    both = one[3] >= 478 * PIXEL and other[3] >= 478 * PIXEL
    return one[2] - other[2] > 4 * PIXEL if both else other[3] - one[3] > 2 * PIXEL


def hidden_share(box, others):
    """The share of a box that the nearer ones of other boxes hide; None of an empty box."""
    own = corners(*box)
    left, right, top, bottom = own
    if left >= right or top >= bottom:
        return None
    hiding = []
    for other in (corners(*other) for other in others):
        if nearer(own, other):
            begin = other[0] + (left - other[0]) // TURN * TURN
            for start in (begin, begin + TURN):
                part = (start, start + other[1] - other[0], *other[2:])
                hiding.append((max(part[0], left), min(part[1], right), max(part[2], top), min(part[3], bottom)))
    hiding = [part for part in hiding if part[0] < part[1] and part[2] < part[3]]
    # A grid whose lines are all edges: each cell is hidden or is not.
    columns = np.unique([left, right, *(edge for part in hiding for edge in part[:2])])
    rows = np.unique([top, bottom, *(edge for part in hiding for edge in part[2:])])
    hidden = np.zeros((len(rows) - 1, len(columns) - 1), bool)
    for begin, end, high, low in hiding:
        hidden[
            np.searchsorted(rows, high) : np.searchsorted(rows, low), slice(*np.searchsorted(columns, [begin, end]))
        ] = 1
    area = int((np.outer(np.diff(rows), np.diff(columns)) * hidden).sum())
    return Fraction(area, (right - left) * (bottom - top))


class Covering:
    """The shares of all people, {(frame, track): record with x, y, w, h}."""

    def __init__(self, people):
        self.frames = {}
        for (frame, track), record in people.items():
            self.frames.setdefault(frame, {})[track] = tuple(record[side] for side in "xywh")
        self.share = cache(self._share)

    def _share(self, frame, track):
        boxes = self.frames[frame]
        return hidden_share(boxes[track], [box for other, box in boxes.items() if other != track])
