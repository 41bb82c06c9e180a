"""Visibility of boxes in crops: in the forward view, in any single view, and in as few crops as possible.

The functions take arrays of boxes in stitched pixels.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from jrdb_avr.schema.arrays import Floats
from jrdb_avr.schema.panorama import CROP, WIDTH, crop_left

AHEAD_DEG: Final = 180.0
"""Angle of the forward view, the only one of a method that does not turn."""


def shares(x: Floats, w: Floats, left: float | Floats) -> Floats:
    """Return the share of each box's width inside a crop.

    Args:
        x: Left columns of the boxes.
        w: Widths of the boxes.
        left: Left column of the crop.

    Returns:
        The shares, 0 to 1. The share of a box without width is 0.
    """
    center = (x + w / 2 - left - CROP / 2 + WIDTH / 2) % WIDTH - WIDTH / 2 + CROP / 2
    seen = np.minimum(center - w / 2 + w, float(CROP)) - np.maximum(center - w / 2, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.maximum(seen, 0.0) / w
    return np.where(w > 0, share, 0.0)


def ahead(x: Floats, w: Floats, share: float) -> np.ndarray:
    """Return whether the view straight ahead shows at least a share of each box's width.

    Args:
        x: Left columns of the boxes.
        w: Widths of the boxes.
        share: Minimum share, 0 to 1.

    Returns:
        A truth value per box.
    """
    return shares(x, w, crop_left(AHEAD_DEG)) >= share


def single_view(x: Floats, w: Floats, share: float) -> bool:
    """Return whether a single angle shows at least a share of each box's width.

    Args:
        x: Left columns of the boxes.
        w: Widths of the boxes.
        share: Minimum share, 0 to 1.

    Returns:
        Whether such an angle exists.
    """
    if len(x) == 0:
        return True
    # The best view has some box exactly as far inside as it must be; crops start at whole columns, so the columns
    # beside those edges are tried too.
    inset = w * share
    edges = np.concatenate([x + inset - CROP, x + w - inset])
    lefts = np.concatenate([np.floor(edges), np.ceil(edges)]) % WIDTH
    return bool(np.any(np.all(shares(x[None, :], w[None, :], lefts[:, None]) >= share, axis=1)))


def min_crops_of_frame(centers: Iterable[float]) -> int:
    """Count the crops that are needed to show at least half of the width of each box of a frame.

    A crop begins at a whole column. A box is at most two crops wide, so that a crop shows half of the box if the box's
    centre is inside the crop or on its edge. So the task is to cover points on a circle by closed arcs. Each arc of a
    cover can be turned clockwise until it begins at a point. Then the next arc best begins at the first missing point.
    So it is enough to try each point as the first one.

    Args:
        centers: Centre columns of the boxes. They wrap around.

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
        boxes: Frame, left column and width of each box.

    Returns:
        The smallest number of looks.
    """
    frames: dict[int, list[float]] = {}
    for frame, x, w in boxes:
        frames.setdefault(frame, []).append(x + w / 2)
    return sum(min_crops_of_frame(centers) for centers in frames.values())
