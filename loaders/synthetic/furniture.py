"""Things that stand or roll in the world, drawn into their boxes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2

from jrdb_avr.loaders.synthetic.figures import Color, Image, Pen

Draw = Callable[[Image, tuple[int, int, int, int], Pen, int], None]

_WOOD: Final[Color] = (112, 84, 58)
_DARK: Final[Color] = (52, 52, 56)


def draw_thing(image: Image, category: str, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    """Draw a thing into its box (x, y, w, h in pixels), in place."""
    _DRAWERS.get(category, _board)(image, box, pen, thing)


def _part(
    image: Image, box: tuple[int, int, int, int], u0: float, v0: float, u1: float, v1: float, color: Color
) -> None:
    """A filled rectangle in shares of the box."""
    x, y, w, h = box
    cv2.rectangle(image, (x + round(u0 * w), y + round(v0 * h)), (x + round(u1 * w), y + round(v1 * h)), color, -1)


def _board(image: Image, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    """A surface on two legs."""
    _part(image, box, 0.1, 0.3, 0.16, 1, pen(_DARK, thing))
    _part(image, box, 0.84, 0.3, 0.9, 1, pen(_DARK, thing))
    _part(image, box, 0, 0, 1, 0.6, pen(_DARK, thing))
    _part(image, box, 0.04, 0.04, 0.96, 0.56, pen((150, 160, 150), thing))
    for row in (0.14, 0.26, 0.38):
        _part(image, box, 0.12, row, 0.7, row + 0.04, pen((70, 90, 120), thing))


def _television(image: Image, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    _part(image, box, 0.46, 0.4, 0.54, 1, pen(_DARK, thing))
    _part(image, box, 0, 0, 1, 0.46, pen((25, 25, 28), thing))
    _part(image, box, 0.05, 0.04, 0.95, 0.42, pen((60, 90, 130), thing))


def _statue(image: Image, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    x, y, w, h = box
    color = pen((128, 126, 120), thing)
    _part(image, box, 0.1, 0.7, 0.9, 1, pen((100, 98, 92), thing))
    _part(image, box, 0.3, 0.25, 0.7, 0.7, color)
    cv2.circle(image, (x + w // 2, y + round(0.14 * h)), max(1, round(0.13 * h)), color, -1)


def _door(image: Image, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    x, y, w, h = box
    _part(image, box, 0, 0, 1, 1, pen((66, 48, 36), thing))
    _part(image, box, 0.1, 0.05, 0.9, 1, pen((124, 92, 62), thing))
    cv2.circle(image, (x + round(0.8 * w), y + h // 2), max(1, round(0.06 * w)), pen((170, 150, 90), thing), -1)


def _table(image: Image, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    color = pen(_WOOD, thing)
    _part(image, box, 0, 0, 1, 0.12, color)
    _part(image, box, 0.06, 0.1, 0.12, 1, color)
    _part(image, box, 0.88, 0.1, 0.94, 1, color)


def _chair(image: Image, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    color = pen((95, 75, 55), thing)
    _part(image, box, 0.05, 0, 0.2, 1, color)
    _part(image, box, 0.05, 0.5, 0.95, 0.62, color)
    _part(image, box, 0.8, 0.55, 0.92, 1, color)


def _trolley(image: Image, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    x, y, w, h = box
    _part(image, box, 0, 0.1, 1, 0.75, pen((90, 110, 130), thing))
    _part(image, box, 0.05, 0.2, 0.95, 0.65, pen((120, 100, 70), thing))
    for u in (0.15, 0.85):
        cv2.circle(
            image, (x + round(u * w), y + round(0.87 * h)), max(1, round(0.12 * h)), pen((35, 35, 38), thing), -1
        )


def _bin(image: Image, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    _part(image, box, 0.08, 0.08, 0.92, 1, pen((60, 84, 66), thing))
    _part(image, box, 0, 0, 1, 0.12, pen((44, 60, 50), thing))


def _shelf(image: Image, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    _part(image, box, 0, 0, 1, 1, pen((72, 56, 42), thing))
    for row in (0.06, 0.36, 0.66):
        _part(image, box, 0.06, row, 0.94, row + 0.24, pen((140, 120, 96), thing))


def _cone(image: Image, box: tuple[int, int, int, int], pen: Pen, thing: int) -> None:
    _part(image, box, 0, 0.9, 1, 1, pen((60, 50, 45), thing))
    for step in range(6):
        top, half = step * 0.15, 0.08 + 0.06 * step
        _part(image, box, 0.5 - half, top, 0.5 + half, top + 0.15, pen(_CONE[step % 2], thing))


_CONE: Final[tuple[Color, ...]] = ((185, 90, 40), (170, 165, 155))

_DRAWERS: Final[dict[str, Draw]] = {
    "television": _television,
    "statues": _statue,
    "door": _door,
    "table": _table,
    "chair/sofa": _chair,
    "trolley": _trolley,
    "trash_bin": _bin,
    "shelf": _shelf,
    "pole/trafficcone": _cone,
}
