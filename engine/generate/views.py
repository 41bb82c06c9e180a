"""Visibility of boxes in crops: in the forward view, and in any single view.

The functions take arrays of boxes in stitched pixels.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from jrdb_avr.schema.arrays import Floats
from jrdb_avr.schema.panorama import CROP, WIDTH, crop_left

AHEAD_DEG: Final = 180.0
"""Angle of the forward view, the only one of a method that does not turn."""


def shares(x: Floats, w: Floats, left: float | Floats) -> Floats:
    """Return the share of each box's width inside a crop.

    Args:
        x: Left columns of the boxes, in stitched pixels.
        w: Widths of the boxes, in pixels.
        left: Left column of the crop, in stitched pixels.

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
        x: Left columns of the boxes, in stitched pixels.
        w: Widths of the boxes, in pixels.
        share: Minimum share, 0 to 1.

    Returns:
        A truth value per box.
    """
    return shares(x, w, crop_left(AHEAD_DEG)) >= share


def single_view(x: Floats, w: Floats, share: float) -> bool:
    """Return whether a single angle shows at least a share of each box's width.

    Args:
        x: Left columns of the boxes, in stitched pixels.
        w: Widths of the boxes, in pixels.
        share: Minimum share, 0 to 1.

    Returns:
        Whether such an angle exists. True if there are no boxes.
    """
    if len(x) == 0:
        return True
    # The best view has some box exactly as far inside as it must be; crops start at whole columns, so the columns
    # beside those edges are tried too.
    inset = w * share
    edges = np.concatenate([x + inset - CROP, x + w - inset])
    lefts = np.concatenate([np.floor(edges), np.ceil(edges)]) % WIDTH
    return bool(np.any(np.all(shares(x[None, :], w[None, :], lefts[:, None]) >= share, axis=1)))
