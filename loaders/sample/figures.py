"""People as simple figures: body, head, limbs, posture, and what they hold, drawn into a box.

Colours are RGB and stay below the brightness that a mark's plate alone has. Coordinates inside a figure: `u` from -0.5
(left) to 0.5 (right) of the box's width, `v` from 0 (top) to 1 (feet).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
Color = tuple[int, int, int]
Point = tuple[int, int]

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
_PROP: Final[Color] = (150, 130, 60)

_PROPS: Final = frozenset(
    ("holding sth", "typing", "eating sth", "talking on the phone", "reading", "writing", "looking into sth")
)


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
    """A body in its box (x, y, w, h in pixels, not cut at the image): pose and other actions by name; `side` is
    where it faces, -1 left to 1 right; `stride` the phase of its gait in radians."""

    x: int
    y: int
    w: int
    h: int
    pose: str
    actions: tuple[str, ...]
    side: float
    stride: float
    look: Look


def draw_figure(image: Image, figure: Figure) -> None:
    """Draw the figure, in place."""
    _DRAWERS.get(figure.pose, _upright)(image, figure)


def _at(figure: Figure, u: float, v: float) -> Point:
    return round(figure.x + (0.5 + u) * figure.w), round(figure.y + v * figure.h)


def _limb(image: Image, points: list[Point], color: Color, thick: float) -> None:
    line = max(1, round(thick))
    for a, b in itertools.pairwise(points):
        cv2.line(image, a, b, color, line)


def _head(image: Image, figure: Figure, u: float, v: float, size: float) -> None:
    """A head with hair; `size` is its radius in pixels."""
    center = _at(figure, u, v)
    radius = max(2, round(size))
    cv2.circle(image, center, radius, figure.look.skin, -1)
    # Hair at the side turned away, all over for who looks away.
    cv2.ellipse(image, center, (radius, radius), 0, 180, 360, figure.look.hair, -1)
    if radius >= 6:
        eye = (round(center[0] + figure.side * radius * 0.5), center[1] + radius // 4)
        cv2.circle(image, eye, max(1, radius // 6), (30, 30, 30), -1)


def _torso(image: Image, figure: Figure, hip: Point, neck: Point, width: float) -> None:
    """A body from hip to neck, with shoulders a little wider than the waist."""
    dx, dy = neck[0] - hip[0], neck[1] - hip[1]
    length = math.hypot(dx, dy) or 1.0
    nx, ny = -dy / length, dx / length
    half = width / 2
    corners = [
        (hip[0] + nx * half * 0.85, hip[1] + ny * half * 0.85),
        (neck[0] + nx * half, neck[1] + ny * half),
        (neck[0] - nx * half, neck[1] - ny * half),
        (hip[0] - nx * half * 0.85, hip[1] - ny * half * 0.85),
    ]
    cv2.fillConvexPoly(image, np.array(corners).round().astype(np.int32), figure.look.shirt)


def _arms(image: Image, figure: Figure, u: float, shoulder: float, hand: float, spread: float) -> None:
    """Two arms from the shoulders at height `shoulder` down to `hand`; what the person does moves one of them."""
    thick = figure.h * 0.05
    turn = 1 if figure.side >= 0 else -1
    left, right = _at(figure, u - spread, shoulder), _at(figure, u + spread, shoulder)
    rest = _at(figure, u - turn * spread * 1.25, hand)
    _limb(image, [left if turn > 0 else right, rest], figure.look.shirt, thick)
    start = right if turn > 0 else left
    if "pointing at sth" in figure.actions:
        end = _at(figure, u + turn * 0.46, shoulder + 0.02)
    elif "greeting gestures" in figure.actions:
        end = _at(figure, u + turn * 0.42, max(0.02, shoulder - 0.16))
    elif "talking on the phone" in figure.actions:
        end = _at(figure, u + turn * 0.2, max(0.05, shoulder - 0.1))
    elif _PROPS.intersection(figure.actions):
        end = _at(figure, u + turn * 0.4, shoulder + (hand - shoulder) * 0.6)
    else:
        end = _at(figure, u + turn * spread * 1.3, hand)
    _limb(image, [start, end], figure.look.shirt, thick)
    if _PROPS.intersection(figure.actions):
        size = max(1, round(figure.h * 0.03))
        cv2.rectangle(image, (end[0] - size, end[1] - size), (end[0] + size, end[1] + size), _PROP, -1)


def _upright(image: Image, figure: Figure) -> None:
    """Standing, walking, running and stairs: legs swing with the stride."""
    swing = {"standing": 0.0, "running": 0.34}.get(figure.pose, 0.24) * math.sin(figure.stride)
    lean = {"running": 0.1, "standing": 0.0}.get(figure.pose, 0.03) * figure.side
    thick = figure.h * 0.075
    hip = _at(figure, 0, 0.53)
    for offset, move in ((-0.1, swing), (0.1, -swing)):
        knee = _at(figure, offset + move * 0.6, 0.76)
        foot = _at(figure, offset + move, 0.98)
        _limb(image, [(hip[0] + round(offset * figure.w * 0.8), hip[1]), knee, foot], figure.look.trousers, thick)
    _torso(image, figure, hip, _at(figure, lean, 0.19), min(figure.w * 0.56, figure.h * 0.26))
    _arms(image, figure, lean, 0.22, 0.52, min(0.3, 0.14 * figure.h / max(figure.w, 1)))
    _head(image, figure, lean * 1.3, 0.085, figure.h * 0.08)


def _sitting(image: Image, figure: Figure) -> None:
    turn = 1 if figure.side >= 0 else -1
    thick = figure.h * 0.1
    back = -turn * 0.3
    cv2.rectangle(image, _at(figure, -0.4, 0.62), _at(figure, 0.4, 0.69), (95, 75, 55), -1)
    _limb(image, [_at(figure, back, 0.3), _at(figure, back, 0.99)], (95, 75, 55), figure.h * 0.04)
    _limb(image, [_at(figure, -back, 0.66), _at(figure, -back, 0.99)], (95, 75, 55), figure.h * 0.04)
    for offset in (-0.06, 0.06):
        hip, knee = _at(figure, -turn * 0.1 + offset, 0.6), _at(figure, turn * 0.3 + offset, 0.62)
        _limb(image, [hip, knee, _at(figure, turn * 0.32 + offset, 0.97)], figure.look.trousers, thick)
    _torso(image, figure, _at(figure, -turn * 0.1, 0.62), _at(figure, -turn * 0.04, 0.24), figure.w * 0.48)
    _arms(image, figure, -turn * 0.04, 0.28, 0.56, 0.22)
    _head(image, figure, -turn * 0.02, 0.115, figure.h * 0.108)


def _bending(image: Image, figure: Figure) -> None:
    turn = 1 if figure.side >= 0 else -1
    hip = _at(figure, -turn * 0.18, 0.3)
    neck = _at(figure, turn * 0.2, 0.26)
    for offset in (-0.06, 0.06):
        _limb(image, [hip, _at(figure, -turn * 0.12 + offset, 0.98)], figure.look.trousers, figure.h * 0.11)
    _torso(image, figure, hip, neck, figure.h * 0.34)
    _limb(image, [neck, _at(figure, turn * 0.32, 0.82)], figure.look.shirt, figure.h * 0.07)
    _head(image, figure, turn * 0.34, 0.3, figure.h * 0.12)


def _lying(image: Image, figure: Figure) -> None:
    turn = 1 if figure.side >= 0 else -1
    cv2.rectangle(image, _at(figure, -0.49, 0.8), _at(figure, 0.49, 1.0), (90, 100, 90), -1)
    _limb(
        image, [_at(figure, -turn * 0.05, 0.58), _at(figure, -turn * 0.46, 0.66)], figure.look.trousers, figure.h * 0.4
    )
    _torso(image, figure, _at(figure, -turn * 0.08, 0.55), _at(figure, turn * 0.26, 0.5), figure.h * 0.55)
    _head(image, figure, turn * 0.38, 0.45, figure.h * 0.28)


def _wheels(image: Image, figure: Figure, size: float) -> None:
    radius = max(2, round(size))
    for u in (-0.33, 0.33):
        center = _at(figure, u, 1.0)
        cv2.circle(image, (center[0], center[1] - radius), radius, (35, 35, 38), max(1, radius // 6))


def _cycling(image: Image, figure: Figure) -> None:
    turn = 1 if figure.side >= 0 else -1
    radius = min(figure.h * 0.2, figure.w * 0.18)
    seat, bar = _at(figure, -turn * 0.12, 0.52), _at(figure, turn * 0.24, 0.46)
    low = _at(figure, 0.0, 0.82)
    front, back = _at(figure, turn * 0.33, 0.82), _at(figure, -turn * 0.33, 0.82)
    _wheels(image, figure, radius)
    _limb(image, [back, seat, low, back], _METAL, figure.h * 0.02)
    _limb(image, [low, bar, front], _METAL, figure.h * 0.02)
    for phase in (0.0, math.pi):
        du, dv = 0.06 * math.cos(figure.stride + phase), 0.06 * math.sin(figure.stride + phase)
        knee = _at(figure, turn * 0.1, 0.64 + dv * 0.6)
        _limb(image, [seat, knee, _at(figure, du, 0.84 + dv)], figure.look.trousers, figure.h * 0.07)
    neck = _at(figure, turn * 0.06, 0.2)
    _torso(image, figure, seat, neck, figure.h * 0.19)
    _limb(image, [neck, bar], figure.look.shirt, figure.h * 0.05)
    _head(image, figure, turn * 0.1, 0.09, figure.h * 0.075)


def _on_board(image: Image, figure: Figure) -> None:
    """Skating, and scootering with its handle."""
    turn = 1 if figure.side >= 0 else -1
    board = _at(figure, -0.42, 0.94), _at(figure, 0.42, 0.965)
    cv2.rectangle(image, *board, (90, 50, 40), -1)
    _wheels(image, figure, max(2.0, figure.h * 0.02))
    hip = _at(figure, 0, 0.53)
    for u in (-0.18, 0.14):
        _limb(image, [hip, _at(figure, u * 1.1, 0.75), _at(figure, u, 0.93)], figure.look.trousers, figure.h * 0.075)
    neck = _at(figure, turn * 0.05, 0.19)
    _torso(image, figure, hip, neck, min(figure.w * 0.5, figure.h * 0.24))
    if figure.pose == "scootering":
        bar = _at(figure, turn * 0.36, 0.42)
        _limb(image, [bar, _at(figure, turn * 0.38, 0.94)], _METAL, figure.h * 0.025)
        _limb(image, [neck, bar], figure.look.shirt, figure.h * 0.05)
    else:
        _arms(image, figure, 0.0, 0.22, 0.4, 0.3)
    _head(image, figure, turn * 0.06, 0.085, figure.h * 0.08)


_DRAWERS: Final = {
    "sitting": _sitting,
    "bending": _bending,
    "lying": _lying,
    "cycling": _cycling,
    "skating": _on_board,
    "scootering": _on_board,
}
