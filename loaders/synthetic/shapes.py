"""Load the numbers of the sample's drawings: furniture, things that people hold, and bodies.

`drawings.json` holds the numbers. Colours are RGB.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

Color = tuple[int, int, int]
Rectangle = tuple[float, float, float, float]
"""Left, top, right and bottom edge in shares of the box."""

WOOD: Final[Color] = (95, 75, 55)
METAL: Final[Color] = (70, 72, 78)
RUBBER: Final[Color] = (35, 35, 38)


class Disc(msgspec.Struct, frozen=True):
    """Filled circle: its middle in shares of the box, its radii in shares of width and height."""

    u: float
    v: float
    of_width: float
    of_height: float


class Standing(NamedTuple):
    """Form of a thing: metres across and high, and its parts by colour, in the order of drawing."""

    width: float
    height: float
    parts: list[tuple[Color, list[Rectangle | Disc]]]


class _Drawings(msgspec.Struct):
    standing: dict[str, Standing]
    """Forms of furniture by category."""
    held: dict[str, tuple[float, float, Color]]
    """Blocks in a hand by category: width and height in metres, and colour."""
    bodies: dict[str, list[list[float]]]
    """Forward, left and down offsets by pose. Upright poses are missing.

    A list has head, neck and middle of the hips, then the left shoulder, elbow, wrist, hip, knee and foot.
    """
    reach: dict[str, list[list[float]]]
    """Offsets of elbow and wrist by action."""


DRAWINGS: Final = msgspec.json.decode((Path(__file__).parent / "drawings.json").read_bytes(), type=_Drawings)


def shade(color: Color, *change: int) -> Color:
    """Return a lighter or darker colour, by one amount or by one amount per channel."""
    red, green, blue = np.add(color, change).tolist()
    return red, green, blue
