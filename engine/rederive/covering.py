"""Covered area of a box: its part inside the boxes of nearer people."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

from jrdb_avr.schema.panorama import HEIGHT, WIDTH, Box

_PARTS = 256
"""Number of length units in a pixel."""
_ROUND = WIDTH * _PARTS
"""Circumference of the panorama in length units."""


class Outline(NamedTuple):
    """Box in whole length units, cut to the panorama's rows and to one turn. `right` and `bottom` are exclusive."""

    left: int
    right: int
    top: int
    bottom: int

    @property
    def area(self) -> int:
        """Area in square length units."""
        return (self.right - self.left) * (self.bottom - self.top)


def outline_of(box: Box) -> Outline:
    """Return the outline of a box. Its left edge is in the panorama. Its right edge may be beyond the seam."""
    left, right = round(box.x * _PARTS), round((box.x + box.w) * _PARTS)
    start = left % _ROUND
    top, bottom = (min(max(round(row * _PARTS), 0), HEIGHT * _PARTS) for row in (box.y, box.y + box.h))
    return Outline(start, start + min(right - left, _ROUND), top, bottom)


def is_nearer(outline: Outline, rival: Outline) -> bool:
    """Return whether a rival is nearer: its bottom is lower. If the image cuts off both boxes, its top is higher."""
    cut_off = (HEIGHT - 2) * _PARTS
    if outline.bottom >= cut_off and rival.bottom >= cut_off:
        return outline.top - rival.top > 4 * _PARTS
    return rival.bottom - outline.bottom > 2 * _PARTS


def covered_area(outline: Outline, rivals: Iterable[Outline]) -> int:
    """Return the area of a box inside the union of the nearer boxes.

    Args:
        outline: The box.
        rivals: The boxes of the people in the frame. No box is nearer than itself.

    Returns:
        Area in square length units.
    """
    hiding = []
    for box in rivals:
        top, bottom = max(outline.top, box.top), min(outline.bottom, box.bottom)
        if top >= bottom or not is_nearer(outline, box):
            continue
        for turn in (-_ROUND, 0, _ROUND):
            left, right = max(outline.left, box.left + turn), min(outline.right, box.right + turn)
            hiding += [Outline(left, right, top, bottom)] if left < right else []
    hiding.sort()
    rows = sorted({row for box in hiding for row in (box.top, box.bottom)})
    area = 0
    for top, bottom in pairwise(rows):
        reached = outline.left
        for box in hiding:
            if box.top <= top and box.bottom >= bottom and box.right > reached:
                area += (box.right - max(box.left, reached)) * (bottom - top)
                reached = box.right
    return area
