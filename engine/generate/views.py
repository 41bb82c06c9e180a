"""What crops show: boxes against the view straight ahead and against any one view, set-wise.

The functions take arrays of boxes in stitched pixels and agree with `schema.panorama.visible_share`, which judges one
box at a time.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from jrdb_avr.schema.arrays import Floats
from jrdb_avr.schema.panorama import CROP, WIDTH, crop_left

AHEAD_DEG: Final = 180.0
"""Angle of the view straight ahead, which is all that somebody sees who does not turn."""


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
    lefts = np.unique(np.concatenate([np.floor(edges), np.ceil(edges)]) % WIDTH)
    return bool(np.any(np.all(shares(x[None, :], w[None, :], lefts[:, None]) >= share, axis=1)))
