"""Geometry of the stitched panorama.

The whole project uses one convention. The panorama has 3760 x 480 pixels and covers 360 degrees, so that columns 0 and
3760 show the same direction.

- *Panorama angle*: `angle = column / 3760 * 360` degrees. It is 0 behind the robot, 90 to its left, 180 straight ahead
  and 270 to its right. It grows clockwise if seen from above.
- *Azimuth*: `a = atan2(y, x)` in the robot frame (x forward, y left). In degrees, `angle = 180 - a`.
- *Box*: (x, y, w, h) in pixels. A box that is shifted by 3760 columns is the same box, so `x` may be negative or above
  3760.

Functions take floats or numpy arrays unless a docstring says otherwise.
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
"""Number of rows that a point appears above HORIZON_ROW, per unit of z / hypot(x, y) in the frame of the rig.

FOCAL_ROWS is the median vertical focal length fy of the rig's cameras. HORIZON_ROW is the median row cy of their
optical centres.
"""


class Box(NamedTuple):
    """Box in pixels of the stitched panorama.

    Attributes:
        x: Left column, which may be outside [0, 3760).
        y: Top row.
        w: Width.
        h: Height.
    """

    x: float
    y: float
    w: float
    h: float


def angle_of_column(column: F) -> F:
    """Return the panorama angle in degrees, [0, 360), of a column in stitched pixels. The column may have any value."""
    # If the column is a tiny negative number, the first modulo rounds to exactly WIDTH, and the second gives 0.
    return (column % WIDTH) % WIDTH * (360.0 / WIDTH)


def column_of_angle(angle_deg: F) -> F:
    """Return the column, [0, 3760), of a panorama angle in degrees. The angle may have any finite value."""
    return (angle_deg % 360.0) % 360.0 * (WIDTH / 360.0)


def angle_of_azimuth(azimuth_rad: F) -> F:
    """Return the panorama angle in degrees, [0, 360), of an azimuth in radians (counter-clockwise from ahead)."""
    return ((180.0 - azimuth_rad * (180.0 / math.pi)) % 360.0) % 360.0


def row_of_height(z: F, ground_distance: F) -> F:
    """Return the row of a point in stitched pixels.

    The point is `z` metres above the camera rig. Its distance from the rig, along the ground, is `ground_distance`
    metres.
    """
    return HORIZON_ROW - FOCAL_ROWS * z / ground_distance


def center_angle(x: F, w: F) -> F:
    """Return the panorama angle in degrees of the centre column of boxes with left edge `x` and width `w`."""
    return angle_of_column(x + w / 2)


def clockwise(start_deg: F, end_deg: F) -> F:
    """Return the clockwise turn (to the robot's right) from one angle to another, in degrees, [0, 360)."""
    return ((end_deg - start_deg) % 360.0) % 360.0


def angle_error(a_deg: F, b_deg: F) -> F:
    """Return the smallest turn between two angles, in degrees, [0, 180]."""
    turn = (a_deg - b_deg) % 360.0
    return cast(F, np.minimum(turn, 360.0 - turn))


def crop_left(angle_deg: float) -> float:
    """Return the left column, a whole number in [0, 3760), of the crop that is centred on a panorama angle."""
    return float((round(column_of_angle(angle_deg)) - CROP // 2) % WIDTH)


def to_crop(box: Box, left: float) -> Box:
    """Convert a box from stitched pixels to pixels of the crop that begins at column `left`.

    The panorama repeats every 3760 columns. So the box has a copy every 3760 columns, and the function returns the
    copy nearest to the crop.
    """
    center = (box.x + box.w / 2 - left - CROP / 2 + WIDTH / 2) % WIDTH - WIDTH / 2 + CROP / 2
    return Box(center - box.w / 2, box.y, box.w, box.h)


def from_crop(box: Box, left: float) -> Box:
    """Convert a box from pixels of the crop that begins at column `left` to stitched pixels.

    The x of the result may exceed 3760 if the crop crosses the seam between the columns 3759 and 0.
    """
    return Box(box.x + left, box.y, box.w, box.h)


def iou(a: Box, b: Box) -> float:
    """Return the intersection over union of two boxes in stitched pixels, [0, 1].

    A box covers the columns [x, x + w) and the rows [y, y + h). Boxes may cross the seam between the columns 3759
    and 0. So one box is first shifted by the multiple of 3760 columns that gives the largest overlap. The parts of
    boxes above and below the image count too. The result is 0 if the area of a box is 0.
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
    # The area of a tiny box may be rounded to 0.
    if overlap <= 0:
        return 0.0
    # Rounding may give slightly more than 1 for equal boxes.
    return min(1.0, overlap / (a.w * a.h + b.w * b.h - overlap))
