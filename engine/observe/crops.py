"""Smallest number of looks that show all boxes of a question."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence

from jrdb_avr.schema.panorama import CROP, WIDTH


def min_crops_of_frame(centers: Iterable[float]) -> int:
    """Count the crops that are needed to show at least half of the width of each box of a frame.

    A crop begins at a whole column. A box is at most two crops wide, so that a crop shows half of the box if the box's
    centre is inside the crop or on its edge. So the task is to cover points on a circle by closed arcs. Each arc of a
    cover can be turned clockwise until it begins at a point. Then the next arc best begins at the first missing point.
    So it is enough to try each point as the first one.

    Args:
        centers: Centre columns of the boxes in stitched pixels. They may have any value, and wrap around at 3760.

    Returns:
        The smallest number of crops.
    """
    points = sorted({center % WIDTH % WIDTH for center in centers})
    turned = points + [point + WIDTH for point in points]
    return min((_arcs(turned, first, first + len(points)) for first in range(len(points))), default=0)


def _arcs(points: Sequence[float], first: int, end: int) -> int:
    """Count the arcs over the points from `first` to before `end`. Each arc begins at the first missing point."""
    count = 0
    while first < end:
        first = bisect_right(points, math.floor(points[first]) + CROP)
        count += 1
    return count


def min_crops(boxes: Iterable[tuple[int, float, float]]) -> int:
    """Count the looks that are needed to show all boxes. A look shows one crop of one frame.

    Args:
        boxes: Frame, left column and width of each box, in stitched pixels.

    Returns:
        The smallest number of looks.
    """
    every = [(frame, x + w / 2) for frame, x, w in boxes]
    frames = {frame for frame, _ in every}
    return sum(min_crops_of_frame(center for at, center in every if at == frame) for frame in frames)
