"""People as simple figures round their joints, with what they sit on, ride and hold.

Colours are RGB and stay below the brightness that a mark's plate alone has. A figure is drawn by a pen, which turns
the colour of a part into what goes into the image: the colour itself, or the number of the part's segment.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.synthetic.skeleton import (
    HEAD,
    HIP,
    L_ELBOW,
    L_EYE,
    L_FOOT,
    L_HIP,
    L_KNEE,
    L_SHOULDER,
    L_WRIST,
    NECK,
    R_ELBOW,
    R_EYE,
    R_FOOT,
    R_HIP,
    R_KNEE,
    R_SHOULDER,
    R_WRIST,
)

Image = npt.NDArray[Any]
Color = tuple[int, int, int]
Point = tuple[int, int]

BODY: Final = -1
"""The part of a figure that is the person; things have their own numbers."""

Pen = Callable[[Color, int], Color]
"""(colour, part) -> what is drawn; the part is BODY or the place of a thing."""

_SHIRTS: Final[tuple[Color, ...]] = (
    (150, 50, 50),
    (60, 90, 150),
    (60, 120, 70),
    (150, 110, 50),
    (110, 70, 130),
    (60, 130, 140),
    (90, 90, 95),
    (160, 90, 110),
)
_TROUSERS: Final[tuple[Color, ...]] = ((40, 45, 70), (70, 60, 50), (50, 55, 50), (60, 60, 65))
_SKINS: Final[tuple[Color, ...]] = ((180, 140, 115), (150, 110, 85), (110, 80, 60), (170, 130, 100))
_HAIR: Final[tuple[Color, ...]] = ((40, 30, 25), (80, 55, 35), (110, 100, 95), (130, 100, 50))
_METAL: Final[Color] = (70, 72, 78)
_WOOD: Final[Color] = (95, 75, 55)
_PAPER: Final[Color] = (176, 174, 162)


_AWAY: Final = -0.25
"""Turned so far from the robot, a person shows no face, and hides what it holds."""


@dataclass(frozen=True)
class Look:
    """Colours of a person."""

    shirt: Color
    trousers: Color
    skin: Color
    hair: Color


def look_of(identity: int) -> Look:
    """Always the same clothes for the same identity."""
    return Look(
        _SHIRTS[identity % 8],
        _TROUSERS[identity // 8 % 4],
        _SKINS[identity // 32 % 4],
        _HAIR[identity // 128 % 4],
    )


@dataclass(frozen=True)
class Figure:
    """A body in its box (x, y, w, h in pixels, not cut at the image).

    `joints` (17, 2) pixels; `meter` pixels per metre; `across` and `toward` say how it faces (see `skeleton.facing`).
    `under`: the thing that it sits on or rides. `held`: per hand used (right, left), category and thing.
    """

    x: int
    y: int
    w: int
    h: int
    pose: str
    joints: npt.NDArray[np.float64]
    meter: float
    across: float
    toward: float
    look: Look
    under: int
    held: tuple[tuple[int, str, int], ...]


def draw_figure(image: Image, figure: Figure, pen: Pen) -> None:
    """Draw the figure, in place."""
    if figure.pose in _UNDER:
        _UNDER[figure.pose](image, figure, pen)
    right = figure.across >= 0
    # Facing right, the right side of the body is the nearer one.
    near, far = ((_RIGHT, _LEFT), (_LEFT, _RIGHT))[not right]
    if figure.toward < _AWAY:
        _held(image, figure, pen)
    _side(image, figure, pen, far)
    _trunk(image, figure, pen)
    _head(image, figure, pen)
    _side(image, figure, pen, near)
    if figure.toward >= _AWAY:
        _held(image, figure, pen)


def _held(image: Image, figure: Figure, pen: Pen) -> None:
    """What is in the hands; behind the body of one who looks away."""
    for hand, category, thing in figure.held:
        _DRAW_HELD.get(category, _block)(image, figure, pen, _joint(figure, (R_WRIST, L_WRIST)[hand]), category, thing)


_RIGHT: Final = (R_SHOULDER, R_ELBOW, R_WRIST, R_HIP, R_KNEE, R_FOOT)
_LEFT: Final = (L_SHOULDER, L_ELBOW, L_WRIST, L_HIP, L_KNEE, L_FOOT)


def _joint(figure: Figure, number: int) -> Point:
    x, y = figure.joints[number].tolist()
    return round(x), round(y)


def _at(figure: Figure, u: float, v: float) -> Point:
    return round(figure.x + (0.5 + u) * figure.w), round(figure.y + v * figure.h)


def _line(image: Image, points: list[Point], color: Color, thick: float) -> None:
    width = max(1, round(thick))
    for a, b in itertools.pairwise(points):
        cv2.line(image, a, b, color, width)


def _side(image: Image, figure: Figure, pen: Pen, limbs: tuple[int, ...]) -> None:
    """A leg and an arm."""
    shoulder, elbow, wrist, hip, knee, foot = (_joint(figure, number) for number in limbs)
    _line(image, [hip, knee, foot], pen(figure.look.trousers, BODY), 0.13 * figure.meter)
    _line(image, [shoulder, elbow, wrist], pen(figure.look.shirt, BODY), 0.09 * figure.meter)
    cv2.circle(image, wrist, max(1, round(0.05 * figure.meter)), pen(figure.look.skin, BODY), -1)


def _trunk(image: Image, figure: Figure, pen: Pen) -> None:
    numbers = (R_SHOULDER, L_SHOULDER, L_HIP, R_HIP)
    corners = np.array([_joint(figure, number) for number in numbers], np.int32)
    color = pen(figure.look.shirt, BODY)
    cv2.fillConvexPoly(image, cv2.convexHull(corners), color)
    _line(image, [_joint(figure, NECK), _joint(figure, HIP)], color, 0.24 * figure.meter)


def _head(image: Image, figure: Figure, pen: Pen) -> None:
    center = _joint(figure, HEAD)
    radius = max(2, round(0.12 * figure.meter))
    _line(image, [center, _joint(figure, NECK)], pen(figure.look.skin, BODY), 0.1 * figure.meter)
    away = figure.toward < _AWAY
    cv2.circle(image, center, radius, pen(figure.look.hair if away else figure.look.skin, BODY), -1)
    if not away:
        # Hair above and at the back of the head.
        turn = round(-40 * figure.across)
        cv2.ellipse(image, center, (radius, radius), turn, 180, 360, pen(figure.look.hair, BODY), -1)
        if radius >= 6:
            for eye in (R_EYE, L_EYE):
                cv2.circle(image, _joint(figure, eye), max(1, radius // 6), pen((30, 30, 30), BODY), -1)


# ------------------------------------------------------------------------------------------------ below the body


def _chair(image: Image, figure: Figure, pen: Pen) -> None:
    turn = 1 if figure.across >= 0 else -1
    color = pen(_WOOD, figure.under)
    cv2.rectangle(image, _at(figure, -0.4, 0.64), _at(figure, 0.4, 0.71), color, -1)
    _line(image, [_at(figure, -turn * 0.36, 0.3), _at(figure, -turn * 0.36, 0.99)], color, 0.06 * figure.meter)
    _line(image, [_at(figure, turn * 0.3, 0.68), _at(figure, turn * 0.3, 0.99)], color, 0.06 * figure.meter)


def _mat(image: Image, figure: Figure, pen: Pen) -> None:
    cv2.rectangle(image, _at(figure, -0.49, 0.82), _at(figure, 0.49, 1.0), pen((90, 100, 90), BODY), -1)


def _wheels(image: Image, figure: Figure, pen: Pen, radius: float) -> None:
    size = max(2, round(radius))
    for u in (-0.33, 0.33):
        x, y = _at(figure, u, 1.0)
        cv2.circle(image, (x, y - size), size, pen((35, 35, 38), figure.under), max(1, size // 6))


def _bicycle(image: Image, figure: Figure, pen: Pen) -> None:
    turn = 1 if figure.across >= 0 else -1
    color = pen(_METAL, figure.under)
    seat, bar, low = _at(figure, -turn * 0.12, 0.54), _at(figure, turn * 0.24, 0.46), _at(figure, 0.0, 0.82)
    front, back = _at(figure, turn * 0.33, 0.82), _at(figure, -turn * 0.33, 0.82)
    _wheels(image, figure, pen, min(figure.h * 0.2, figure.w * 0.18))
    _line(image, [back, seat, low, back], color, figure.h * 0.02)
    _line(image, [low, bar, front], color, figure.h * 0.02)


def _deck(image: Image, figure: Figure, pen: Pen) -> None:
    """A skateboard, or a scooter with its handle."""
    turn = 1 if figure.across >= 0 else -1
    cv2.rectangle(image, _at(figure, -0.42, 0.945), _at(figure, 0.42, 0.97), pen((90, 50, 40), figure.under), -1)
    _wheels(image, figure, pen, max(2.0, figure.h * 0.02))
    if figure.pose == "scootering":
        pole = [_at(figure, turn * 0.36, 0.42), _at(figure, turn * 0.38, 0.94)]
        _line(image, pole, pen(_METAL, figure.under), figure.h * 0.025)


_UNDER: Final = {
    "sitting": _chair,
    "lying": _mat,
    "cycling": _bicycle,
    "skating": _deck,
    "scootering": _deck,
}


# ------------------------------------------------------------------------------------------------ in the hand

_BLOCKS: Final[dict[str, tuple[float, float, Color]]] = {
    "phone": (0.08, 0.16, (30, 32, 38)),
    "waterbottle": (0.09, 0.26, (70, 120, 160)),
    "box": (0.36, 0.28, (150, 118, 72)),
    "document": (0.24, 0.3, _PAPER),
    "tableware": (0.24, 0.08, (160, 162, 165)),
    "peripheral": (0.42, 0.07, (55, 55, 60)),
    "jacket": (0.26, 0.5, (80, 62, 48)),
}
"""Width and height in metres, colour."""

Draw = Callable[[Image, Figure, Pen, Point, str, int], None]


def _block(image: Image, figure: Figure, pen: Pen, hand: Point, category: str, thing: int) -> None:
    wide, high, color = _BLOCKS[category]
    dx, dy = max(1, round(wide * figure.meter / 2)), max(1, round(high * figure.meter / 2))
    cv2.rectangle(image, (hand[0] - dx, hand[1] - dy), (hand[0] + dx, hand[1] + dy), pen(color, thing), -1)


def _bag(image: Image, figure: Figure, pen: Pen, hand: Point, category: str, thing: int) -> None:
    dx, drop, high = (max(1, round(size * figure.meter)) for size in (0.17, 0.12, 0.34))
    color = pen((140, 70, 40), thing)
    _line(image, [(hand[0] - dx, hand[1] + drop), hand, (hand[0] + dx, hand[1] + drop)], color, 0.03 * figure.meter)
    cv2.rectangle(image, (hand[0] - dx, hand[1] + drop), (hand[0] + dx, hand[1] + drop + high), color, -1)


def _umbrella(image: Image, figure: Figure, pen: Pen, hand: Point, category: str, thing: int) -> None:
    high, reach = round(0.75 * figure.meter), max(2, round(0.3 * figure.meter))
    top = max(hand[1] - high, figure.y + reach)
    color = pen((60, 60, 120), thing)
    _line(image, [hand, (hand[0], top)], color, 0.03 * figure.meter)
    cv2.ellipse(image, (hand[0], top), (reach, reach), 0, 180, 360, color, -1)


_DRAW_HELD: Final[dict[str, Draw]] = {"bag": _bag, "umbrella": _umbrella}
