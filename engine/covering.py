"""How few crops of the panorama show everybody who has to be seen."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence

from jrdb_avr.schema.panorama import CROP, WIDTH


def fewest_crops(centers: Iterable[float]) -> int:
    """The fewest crops that show at least half of the width of every box of one frame.

    `centers` are the boxes' centre columns, any value, wrapped. A crop begins at a whole column and shows at least
    half of a box exactly where the box's centre lies inside it or on its edge, as long as the box is at most two crops
    wide. So what is asked is a cover of points on a circle by closed arcs. Every arc of a cover may be turned
    clockwise until it begins at one of its points, and from there on each next arc best begins at the first point that
    is still missing: trying each point as the first gives the fewest.
    """
    points = sorted({center % WIDTH % WIDTH for center in centers})
    turned = points + [point + WIDTH for point in points]
    return min((_arcs(turned, first, first + len(points)) for first in range(len(points))), default=0)


def _arcs(points: Sequence[float], first: int, end: int) -> int:
    """Arcs that hold the points from `first` to before `end`, each begun at the first that is missing."""
    count = 0
    while first < end:
        first = bisect_right(points, math.floor(points[first]) + CROP)
        count += 1
    return count


def crops_needed(boxes: Iterable[tuple[int, float, float]]) -> int:
    """The fewest looks that show every box: (frame, left edge, width) each; a look shows one crop of one frame."""
    frames: dict[int, list[float]] = {}
    for frame, x, w in boxes:
        frames.setdefault(frame, []).append(x + w / 2)
    return sum(fewest_crops(centers) for centers in frames.values())
