"""Sizes, colours and parts of the things of the sample world: furniture and things that people hold.

Colours are RGB.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

Color = tuple[int, int, int]
Rectangle = tuple[float, float, float, float]
"""Left, top, right and bottom edge in shares of the box."""

WOOD: Final[Color] = (95, 75, 55)
METAL: Final[Color] = (70, 72, 78)
RUBBER: Final[Color] = (35, 35, 38)
_DARK: Final[Color] = (52, 52, 56)
_MIDDLE: Final = 0.49999
"""Return half of a length, rounded down."""


class Disc(NamedTuple):
    """Filled circle: its middle in shares of the box, its radii in shares of width and height."""

    u: float
    v: float
    of_width: float
    of_height: float


class Standing(NamedTuple):
    """Form of a thing: metres across and high, and its parts by colour, in the order of drawing."""

    width: float
    height: float
    parts: tuple[tuple[Color, tuple[Rectangle | Disc, ...]], ...]


_BOARD: Final = (
    (_DARK, ((0.1, 0.3, 0.16, 1), (0.84, 0.3, 0.9, 1), (0, 0, 1, 0.6))),
    ((150, 160, 150), ((0.04, 0.04, 0.96, 0.56),)),
    ((70, 90, 120), tuple((0.12, row, 0.7, row + 0.04) for row in (0.14, 0.26, 0.38))),
)
_TELEVISION: Final = (
    (_DARK, ((0.46, 0.4, 0.54, 1),)),
    ((25, 25, 28), ((0, 0, 1, 0.46),)),
    ((60, 90, 130), ((0.05, 0.04, 0.95, 0.42),)),
)
_STATUE: Final = (
    ((100, 98, 92), ((0.1, 0.7, 0.9, 1),)),
    ((128, 126, 120), ((0.3, 0.25, 0.7, 0.7), Disc(_MIDDLE, 0.14, 0, 0.13))),
)
_DOOR: Final = (
    ((66, 48, 36), ((0, 0, 1, 1),)),
    ((124, 92, 62), ((0.1, 0.05, 0.9, 1),)),
    ((170, 150, 90), (Disc(0.8, _MIDDLE, 0.06, 0),)),
)
_TROLLEY: Final = (
    ((90, 110, 130), ((0, 0.1, 1, 0.75),)),
    ((120, 100, 70), ((0.05, 0.2, 0.95, 0.65),)),
    (RUBBER, (Disc(0.15, 0.87, 0, 0.12), Disc(0.85, 0.87, 0, 0.12))),
)
_SHELF: Final = (
    ((72, 56, 42), ((0, 0, 1, 1),)),
    ((140, 120, 96), tuple((0.06, row, 0.94, row + 0.24) for row in (0.06, 0.36, 0.66))),
)
_HALVES: Final = tuple(0.08 + 0.06 * band for band in range(6))
_CONE: Final = (
    ((60, 50, 45), ((0, 0.9, 1, 1),)),
    *(
        (((185, 90, 40), (170, 165, 155))[k % 2], ((0.5 - half, k * 0.15, 0.5 + half, k * 0.15 + 0.15),))
        for k, half in enumerate(_HALVES)
    ),
)
STANDING: Final = {
    "table": Standing(1.5, 0.72, (((112, 84, 58), ((0, 0, 1, 0.12), (0.06, 0.1, 0.12, 1), (0.88, 0.1, 0.94, 1))),)),
    "board": Standing(1.4, 1.7, _BOARD),
    "poster": Standing(0.8, 1.6, _BOARD),
    "television": Standing(1.1, 1.5, _TELEVISION),
    "statues": Standing(0.6, 1.7, _STATUE),
    "standee": Standing(0.6, 1.6, _BOARD),
    "door": Standing(0.9, 2.0, _DOOR),
    "trolley": Standing(0.7, 0.42, _TROLLEY),
    "trash_bin": Standing(0.45, 0.8, (((60, 84, 66), ((0.08, 0.08, 0.92, 1),)), ((44, 60, 50), ((0, 0, 1, 0.12),)))),
    "chair/sofa": Standing(0.5, 0.85, ((WOOD, ((0.05, 0, 0.2, 1), (0.05, 0.5, 0.95, 0.62), (0.8, 0.55, 0.92, 1))),)),
    "shelf": Standing(1.0, 1.5, _SHELF),
    "pole/trafficcone": Standing(0.35, 0.7, _CONE),
}
"""Forms by category."""

HELD_OBJECTS: Final[dict[str, tuple[float, float, Color]]] = {
    "phone": (0.08, 0.16, (30, 32, 38)),
    "waterbottle": (0.09, 0.26, (70, 120, 160)),
    "box": (0.36, 0.28, (150, 118, 72)),
    "document": (0.24, 0.3, (176, 174, 162)),
    "tableware": (0.24, 0.08, (160, 162, 165)),
    "peripheral": (0.42, 0.07, (55, 55, 60)),
    "jacket": (0.26, 0.5, (80, 62, 48)),
}
"""Blocks in a hand: width and height in metres, and colour."""


def shade(color: Color, *change: int) -> Color:
    """Return a lighter or darker colour, by one amount or by one amount per channel."""
    red, green, blue = np.add(color, change).tolist()
    return red, green, blue
