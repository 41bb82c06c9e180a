"""Geometry of the stitched panorama.

One convention for the whole project. The panorama is 3760 x 480 pixels and covers 360 degrees; column 0 and column
3760 are the same direction. *Panorama angle*: `angle = column / 3760 * 360` degrees, 0 straight behind the robot, 90 at
its left, 180 straight ahead, 270 at its right; angles grow clockwise seen from above. *Azimuth* (robot frame, x
forward, y left): `a = atan2(y, x)`, so `angle = 180 - a` in degrees. Boxes are (x, y, w, h), x may be negative or reach
past 3760: the same box shifted by 3760 is the same box.

Functions take floats or numpy arrays alike unless a docstring says otherwise.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, TypeVar, cast

import numpy as np

from jrdb_avr.schema.arrays import Floats

F = TypeVar("F", float, Floats)

WIDTH: Final = 3760
HEIGHT: Final = 480
CROP: Final = 480
FOV_DEG: Final = CROP * 360 / WIDTH
"""Horizontal field of view of a crop: 45.957 degrees."""

HORIZON_ROW: Final = 209.4
FOCAL_ROWS: Final = 482.9
"""Row of a point: HORIZON_ROW + FOCAL_ROWS * -z / hypot(x, y); medians of the cameras' cy and fy."""


class Box(NamedTuple):
    """A box in stitched pixels: left column, top row, width, height. x may lie outside [0, 3760)."""

    x: float
    y: float
    w: float
    h: float


def angle_of_column(column: F) -> F:
    """Panorama angle in degrees, [0, 360), of a column in pixels (any value, wrapped)."""
    # The second modulo catches a tiny negative column, whose first modulo rounds to exactly WIDTH.
    return (column % WIDTH) % WIDTH * (360.0 / WIDTH)


def column_of_angle(angle_deg: F) -> F:
    """Column in [0, 3760) of a panorama angle in degrees (any finite value, wrapped)."""
    return (angle_deg % 360.0) % 360.0 * (WIDTH / 360.0)


def angle_of_azimuth(azimuth_rad: F) -> F:
    """Panorama angle in degrees, [0, 360), of an azimuth in radians (counter-clockwise from straight ahead)."""
    return ((180.0 - azimuth_rad * (180.0 / math.pi)) % 360.0) % 360.0


def row_of_height(z: F, ground_distance: F) -> F:
    """Row of a point `z` metres above the rig at `ground_distance` = hypot(x, y) metres."""
    return HORIZON_ROW - FOCAL_ROWS * z / ground_distance


def center_angle(x: F, w: F) -> F:
    """Panorama angle of the centre column of boxes with left edge `x` and width `w`."""
    return angle_of_column(x + w / 2)


def clockwise(start_deg: F, end_deg: F) -> F:
    """Degrees, [0, 360), turned clockwise (to the robot's right) from `start_deg` to `end_deg`."""
    return ((end_deg - start_deg) % 360.0) % 360.0


def angle_error(a_deg: F, b_deg: F) -> F:
    """Smallest turn between two angles, [0, 180] degrees."""
    turn = (a_deg - b_deg) % 360.0
    return cast(F, np.minimum(turn, 360.0 - turn))


def crop_left(angle_deg: float) -> float:
    """Left column, [0, 3760), of the crop that `observe` returns for an angle. Always a whole number of pixels."""
    return float((round(column_of_angle(angle_deg)) - CROP // 2) % WIDTH)


def to_crop(box: Box, left: float) -> Box:
    """A stitched box in the pixels of the crop whose left column is `left`; of its copies the nearest to the crop."""
    center = (box.x + box.w / 2 - left - CROP / 2 + WIDTH / 2) % WIDTH - WIDTH / 2 + CROP / 2
    return Box(center - box.w / 2, box.y, box.w, box.h)


def from_crop(box: Box, left: float) -> Box:
    """A box in crop pixels as a stitched box; x may pass 3760 for a crop over the seam."""
    return Box(box.x + left, box.y, box.w, box.h)


def iou(a: Box, b: Box) -> float:
    """Seam-aware intersection over union, [0, 1].

    One box is shifted by multiples of 3760 to where it meets the other best. Rows beyond the image count as they
    are; a box without area scores 0. No "+1 pixel": a box covers [x, x + w) x [y, y + h).
    """
    if not (a.w > 0 and a.h > 0 and b.w > 0 and b.h > 0):
        return 0.0
    rows = min(a.y + a.h, b.y + b.h) - max(a.y, b.y)
    if rows <= 0:
        return 0.0
    apart = (a.x + a.w / 2 - b.x - b.w / 2) / WIDTH
    if not all(map(math.isfinite, (apart, a.y, b.y))):
        return 0.0
    turn = round(apart) * WIDTH
    columns = max(
        min(a.x + a.w, b.x + shift + b.w) - max(a.x, b.x + shift) for shift in (turn - WIDTH, turn, turn + WIDTH)
    )
    overlap = columns * rows
    # The area of a tiny box may be too small for a float.
    if overlap <= 0:
        return 0.0
    # Rounding may lift the share a hair above one for equal boxes.
    return min(1.0, overlap / (a.w * a.h + b.w * b.h - overlap))
