"""Draw people as simple figures around their joints with what they sit on, ride and hold, and of standing things.

A canvas draws the same strokes as a picture, or as the numbers of the segments that the strokes belong to.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.synthetic.shapes import DRAWINGS, METAL, RUBBER, WOOD, Color, Disc
from jrdb_avr.loaders.synthetic.skeleton import (
    HEAD,
    HIP,
    L_EYE,
    L_HIP,
    L_SHOULDER,
    L_WRIST,
    LEFT_SIDE,
    NECK,
    R_EYE,
    R_HIP,
    R_SHOULDER,
    R_WRIST,
    RIGHT_SIDE,
)

Pixels = npt.NDArray[Any]
Point = tuple[int, int]
Angles = tuple[int, int, int]
"""Turn of an ellipse, and start and end of its sector, in degrees."""

OWNER: Final = -1
"""Part of a drawing that is the person or partition itself. Things have their own numbers."""

_SHIRTS: Final[tuple[Color, ...]] = (
    *((150, 50, 50), (60, 90, 150), (60, 120, 70), (150, 110, 50)),
    *((110, 70, 130), (60, 130, 140), (90, 90, 95), (160, 90, 110)),
)
_TROUSERS: Final[tuple[Color, ...]] = ((40, 45, 70), (70, 60, 50), (50, 55, 50), (60, 60, 65))
_SKINS: Final[tuple[Color, ...]] = ((180, 140, 115), (150, 110, 85), (110, 80, 60), (170, 130, 100))
_HAIR: Final[tuple[Color, ...]] = ((40, 30, 25), (80, 55, 35), (110, 100, 95), (130, 100, 50))

AWAY: Final = -0.25
"""Minimum turn from the robot if a person hides the face and the held things."""


@dataclass(frozen=True)
class Canvas:
    """Image with the number of each part. Without numbers, parts have their colours."""

    image: Pixels
    numbers: Mapping[int, int] | None = None

    def _ink(self, color: Color, part: int) -> Color:
        return color if self.numbers is None else (self.numbers[part],) * 3

    def rectangle(self, a: Point, b: Point, color: Color, part: int = OWNER, width: int = -1) -> None:
        """Draw a rectangle; without a width it is filled."""
        cv2.rectangle(self.image, a, b, self._ink(color, part), width)

    def lines(self, points: Sequence[Point], color: Color, part: int = OWNER, width: float = 1) -> None:
        """Draw lines from point to point."""
        for a, b in itertools.pairwise(points):
            cv2.line(self.image, a, b, self._ink(color, part), max(1, round(width)))

    def circle(self, middle: Point, radius: int, color: Color, part: int = OWNER, width: int = -1) -> None:
        """Draw a circle; without a width it is filled."""
        cv2.circle(self.image, middle, radius, self._ink(color, part), width)

    def ellipse(
        self, middle: Point, radii: Point, color: Color, part: int = OWNER, angles: Angles = (0, 0, 360)
    ) -> None:
        """Fill an ellipse, or a sector of it."""
        cv2.ellipse(self.image, middle, radii, *angles, self._ink(color, part), -1)

    def hull(self, points: Sequence[Point], color: Color) -> None:
        """Fill the convex hull of points."""
        cv2.fillConvexPoly(self.image, cv2.convexHull(np.array(points, np.int32)), self._ink(color, OWNER))


Held = tuple[int, str, int]
"""Thing that a person carries or rides: the hand (or `objects.BELOW`), the category and the thing's number."""


@dataclass(frozen=True)
class Figure:
    """Body in its box (x, y, w, h in pixels, not cut at the image).

    `joints`: 17 pixels; `meter`: pixels per metre; `across` and `toward`: how it faces (see `skeleton.facing`).
    `identity` decides the colours; `under`: the thing that it sits on or rides; `held`: what is in its hands.
    """

    x: int
    y: int
    w: int
    h: int
    pose: str
    joints: list[Point]
    meter: float
    across: float
    toward: float
    identity: int
    under: int
    held: tuple[Held, ...]

    def at(self, u: float, v: float) -> Point:
        """Return the pixel at shares of the box: across from its middle, down from its top."""
        return round(self.x + (0.5 + u) * self.w), round(self.y + v * self.h)


def draw_thing(canvas: Canvas, category: str, box: tuple[int, int, int, int], thing: int) -> None:
    """Draw a standing thing into its box (x, y, w, h in pixels), in place."""
    x, y, w, h = box
    for color, shapes in DRAWINGS.standing[category].parts:
        for shape in shapes:
            if isinstance(shape, Disc):
                radius = max(1, round(shape.of_width * w + shape.of_height * h))
                canvas.circle((x + round(shape.u * w), y + round(shape.v * h)), radius, color, thing)
            else:
                u0, v0, u1, v1 = shape
                corners = (x + round(u0 * w), y + round(v0 * h)), (x + round(u1 * w), y + round(v1 * h))
                canvas.rectangle(*corners, color, thing)


def draw_figure(canvas: Canvas, figure: Figure) -> None:
    """Draw the figure, in place."""
    shirt, trousers = _SHIRTS[figure.identity % 8], _TROUSERS[figure.identity // 8 % 4]
    skin, hair = _SKINS[figure.identity // 32 % 4], _HAIR[figure.identity // 128 % 4]
    joints, turned = figure.joints, figure.toward < AWAY
    _draw_under(canvas, figure)
    if turned:
        _draw_held(canvas, figure)
    # Facing right, the right side of the body is the nearer one.
    near, far = (RIGHT_SIDE, LEFT_SIDE) if figure.across >= 0 else (LEFT_SIDE, RIGHT_SIDE)
    _draw_side(canvas, figure, far, shirt, trousers, skin)
    canvas.hull([joints[number] for number in (R_SHOULDER, L_SHOULDER, L_HIP, R_HIP)], shirt)
    canvas.lines([joints[NECK], joints[HIP]], shirt, width=0.24 * figure.meter)
    head, radius = joints[HEAD], max(2, round(0.12 * figure.meter))
    canvas.lines([head, joints[NECK]], skin, width=0.1 * figure.meter)
    canvas.circle(head, radius, hair if turned else skin)
    if not turned:
        # Hair above and at the back of the head.
        canvas.ellipse(head, (radius, radius), hair, angles=(round(-40 * figure.across), 180, 360))
        if radius >= 6:
            for eye in (R_EYE, L_EYE):
                canvas.circle(joints[eye], max(1, radius // 6), (30, 30, 30))
    _draw_side(canvas, figure, near, shirt, trousers, skin)
    if not turned:
        _draw_held(canvas, figure)


def _draw_side(
    canvas: Canvas, figure: Figure, limbs: tuple[int, ...], shirt: Color, trousers: Color, skin: Color
) -> None:
    """Draw a leg and an arm."""
    points = [figure.joints[number] for number in limbs[1:]]
    canvas.lines(points[3:], trousers, width=0.13 * figure.meter)
    canvas.lines(points[:3], shirt, width=0.09 * figure.meter)
    canvas.circle(points[2], max(1, round(0.05 * figure.meter)), skin)


def _draw_under(canvas: Canvas, figure: Figure) -> None:
    """Draw the seat, bed or vehicle of the person."""
    at, part, turn = figure.at, figure.under, 1 if figure.across >= 0 else -1
    match figure.pose:
        case "sitting":
            canvas.rectangle(at(-0.4, 0.64), at(0.4, 0.71), WOOD, part)
            for u, top in ((-0.36, 0.3), (0.3, 0.68)):
                canvas.lines([at(turn * u, top), at(turn * u, 0.99)], WOOD, part, 0.06 * figure.meter)
        case "lying":
            canvas.rectangle(at(-0.49, 0.82), at(0.49, 1.0), (90, 100, 90))
        case "cycling":
            _draw_wheels(canvas, figure, min(figure.h * 0.2, figure.w * 0.18))
            seat, bar, low = at(-turn * 0.12, 0.54), at(turn * 0.24, 0.46), at(0.0, 0.82)
            front, back = at(turn * 0.33, 0.82), at(-turn * 0.33, 0.82)
            canvas.lines([back, seat, low, back], METAL, part, figure.h * 0.02)
            canvas.lines([low, bar, front], METAL, part, figure.h * 0.02)
        case "skating" | "scootering":
            canvas.rectangle(at(-0.42, 0.945), at(0.42, 0.97), (90, 50, 40), part)
            _draw_wheels(canvas, figure, figure.h * 0.02)
            if figure.pose == "scootering":
                canvas.lines([at(turn * 0.36, 0.42), at(turn * 0.38, 0.94)], METAL, part, figure.h * 0.025)


def _draw_wheels(canvas: Canvas, figure: Figure, radius: float) -> None:
    size = max(2, round(radius))
    for u in (-0.33, 0.33):
        x, y = figure.at(u, 1.0)
        canvas.circle((x, y - size), size, RUBBER, figure.under, max(1, size // 6))


def _draw_held(canvas: Canvas, figure: Figure) -> None:
    """Draw the things in the hands. They are behind the body of a person who looks away."""
    meter = figure.meter
    for hand, category, thing in figure.held:
        x, y = figure.joints[(R_WRIST, L_WRIST)[hand]]
        match category:
            case "bag":
                half, drop, high = (max(1, round(size * meter)) for size in (0.17, 0.12, 0.34))
                left, right = (x - half, y + drop), (x + half, y + drop)
                canvas.lines([left, (x, y), right], (140, 70, 40), thing, 0.03 * meter)
                canvas.rectangle(left, (x + half, y + drop + high), (140, 70, 40), thing)
            case "umbrella":
                reach = max(2, round(0.3 * meter))
                top = max(y - round(0.75 * meter), figure.y + reach)
                canvas.lines([(x, y), (x, top)], (60, 60, 120), thing, 0.03 * meter)
                canvas.ellipse((x, top), (reach, reach), (60, 60, 120), thing, (0, 180, 360))
            case _:
                width, height, color = DRAWINGS.held[category]
                dx, dy = max(1, round(width * meter / 2)), max(1, round(height * meter / 2))
                canvas.rectangle((x - dx, y - dy), (x + dx, y + dy), color, thing)
