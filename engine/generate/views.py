"""Visibility of boxes in crops: in the forward view, in any one view, and the fewest crops that show all.

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
    """Share, [0, 1], of each box's width inside the crop whose left column is `left`; 0 for a box without width."""
    center = (x + w / 2 - left - CROP / 2 + WIDTH / 2) % WIDTH - WIDTH / 2 + CROP / 2
    seen = np.minimum(center - w / 2 + w, float(CROP)) - np.maximum(center - w / 2, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.maximum(seen, 0.0) / w
    return np.where(w > 0, share, 0.0)


def ahead(x: Floats, w: Floats, share: float) -> np.ndarray:
    """Whether at least `share` of each box lies inside the view straight ahead."""
    return shares(x, w, crop_left(AHEAD_DEG)) >= share


def single_view(x: Floats, w: Floats, share: float) -> bool:
    """Whether one angle shows at least `share` of every one of these boxes."""
    if len(x) == 0:
        return True
    # The best view has some box exactly as far inside as it must be; crops start at whole columns, so the columns
    # beside those edges are tried too.
    inset = w * share
    edges = np.concatenate([x + inset - CROP, x + w - inset])
    lefts = np.concatenate([np.floor(edges), np.ceil(edges)]) % WIDTH
    return bool(np.any(np.all(shares(x[None, :], w[None, :], lefts[:, None]) >= share, axis=1)))


def min_crops_of_frame(centers: Iterable[float]) -> int:
    """The fewest crops that show at least half of the width of every box of one frame.

    `centers` are the boxes' centre columns, any value, wrapped. A crop begins at a whole column and shows at least
    half of a box exactly where the box's centre lies inside it or on its edge, as long as the box is at most two crops
    wide. So the task is to cover points on a circle by closed arcs. Every arc of a cover may be turned
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


def min_crops(boxes: Iterable[tuple[int, float, float]]) -> int:
    """The fewest looks that show every box: (frame, left edge, width) each; a look shows one crop of one frame."""
    frames: dict[int, list[float]] = {}
    for frame, x, w in boxes:
        frames.setdefault(frame, []).append(x + w / 2)
    return sum(min_crops_of_frame(centers) for centers in frames.values())
