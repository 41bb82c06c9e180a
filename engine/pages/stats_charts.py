"""Small charts on a light ground, drawn with OpenCV: a canvas, a panel with its title, and the kinds of bars.

Lengths and places are pixels, x to the right and y down; colors are RGB.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from jrdb_avr.schema.method import Image

Color = tuple[int, int, int]
Align = Literal["left", "center", "right"]

GROUND: Final[Color] = (247, 247, 244)
PAPER: Final[Color] = (255, 255, 255)
INK: Final[Color] = (31, 41, 51)
FAINT: Final[Color] = (117, 124, 133)
RULE: Final[Color] = (226, 229, 232)
BLUE: Final[Color] = (62, 116, 166)
RED: Final[Color] = (200, 70, 60)

TITLE, BODY, SMALL = 17, 13, 12
_REGULAR, _BOLD = 400, 600
_ROW, _TIGHT = 34.0, 20.0
"""Height of a line of bars at most, and the height from which on its words are as large as others."""


@dataclass(frozen=True)
class Part:
    """A piece of a stacked bar."""

    name: str
    share: float
    color: Color


class Canvas:
    """A picture of a size that is drawn on."""

    def __init__(self, width: int, height: int) -> None:
        import cv2

        self.image: Image = np.full((height, width, 3), GROUND, np.uint8)
        self._font: Any = cv2.FontFace("sans")

    def text(
        self, place: tuple[float, float], words: str, color: Color = INK, size: int = BODY, *,
        bold: bool = False, align: Align = "left",
    ) -> None:  # fmt: skip
        """Words whose baseline begins, has its middle, or ends at a place."""
        import cv2

        x, y = place
        left = x - {"left": 0.0, "center": 0.5, "right": 1.0}[align] * self.width(words, size, bold=bold)
        weight = _BOLD if bold else _REGULAR
        cv2.putText(self.image, words, (round(left), round(y)), color, self._font, size, weight)

    def width(self, words: str, size: int = BODY, *, bold: bool = False) -> int:
        """How wide words are."""
        import cv2

        height, width = self.image.shape[:2]
        box = cv2.getTextSize((width, height), words, (0, 0), self._font, size, _BOLD if bold else _REGULAR)
        return int(box[0] + box[2])

    def fitted(self, words: str, room: float, size: int = BODY) -> str:
        """The words, cut short with dots where the room is too narrow; nothing where not even four letters fit."""
        if self.width(words, size) <= room:
            return words
        for end in range(len(words) - 1, 3, -1):
            if self.width(short := words[:end].rstrip() + "...", size) <= room:
                return short
        return ""

    def box(self, x: float, y: float, width: float, height: float, color: Color) -> None:
        """A filled rectangle; nothing where it has no pixel."""
        left, top, right, bottom = round(x), round(y), round(x + width), round(y + height)
        self.image[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = color

    def dot(self, x: float, y: float, radius: float, color: Color) -> None:
        """A filled circle with a light rim, so that dots on one another stay apart."""
        import cv2

        # The last argument counts in sixteenths of a pixel.
        center = (round(x * 16), round(y * 16))
        cv2.circle(self.image, center, round((radius + 1) * 16), PAPER, cv2.FILLED, cv2.LINE_AA, 4)
        cv2.circle(self.image, center, round(radius * 16), color, cv2.FILLED, cv2.LINE_AA, 4)


@dataclass(frozen=True)
class Panel:
    """A part of the canvas with a title; charts are drawn inside its margins."""

    canvas: Canvas
    x: float
    y: float
    width: float
    height: float

    MARGIN = 18
    HEAD = 58

    def head(self, title: str, note: str) -> None:
        """The ground, the title, and below it what is shown and of how many."""
        self.canvas.box(self.x, self.y, self.width, self.height, PAPER)
        self.canvas.text((self.x + self.MARGIN, self.y + 28), title, INK, TITLE, bold=True)
        note = self.canvas.fitted(note, self.width - 2 * self.MARGIN, SMALL)
        self.canvas.text((self.x + self.MARGIN, self.y + 47), note, FAINT, SMALL)

    @property
    def left(self) -> float:
        return self.x + self.MARGIN

    @property
    def right(self) -> float:
        return self.x + self.width - self.MARGIN

    @property
    def top(self) -> float:
        return self.y + self.HEAD + 8

    @property
    def bottom(self) -> float:
        return self.y + self.height - self.MARGIN

    def rows(self, names: Sequence[str], room: float, below: float = 0) -> list[float]:
        """Write the names of lines at the left, `room` wide; the middles of the lines. `below` stays free."""
        step = min(_ROW, (self.bottom - below - self.top) / max(1, len(names)))
        size = SMALL if step < _TIGHT else BODY
        middles = [self.top + step * (i + 0.5) for i in range(len(names))]
        for name, middle in zip(names, middles, strict=True):
            words = self.canvas.fitted(name, room - 10, size)
            self.canvas.text((self.left + room - 10, middle + 4), words, INK, size, align="right")
        return middles


def thickness(middles: Sequence[float], most: float) -> float:
    """How thick the bars of lines are."""
    return max(3.0, min(most, (middles[1] - middles[0]) * 0.7)) if len(middles) > 1 else most


def names_width(canvas: Canvas, names: Sequence[str], most: float) -> float:
    """How much room the names of lines take."""
    return min(most, 14 + max((canvas.width(name) for name in names), default=0))


def bars(
    panel: Panel, names: Sequence[str], values: Sequence[int], colors: Sequence[Color], aims: Sequence[int] = ()
) -> None:
    """Lying bars with their numbers; `aims` are numbers to compare with, as upright strokes."""
    canvas = panel.canvas
    room = names_width(canvas, names, panel.width * 0.6)
    middles = panel.rows(names, room)
    thick = thickness(middles, 14)
    start = panel.left + room
    reach = [max(pair) for pair in zip(values, aims, strict=True)] if aims else values
    words = [f"{value:,}" + (f" of {aims[number]:,}" if aims else "") for number, value in enumerate(values)]
    tail = 12 + max((canvas.width(one, SMALL) for one in words), default=0)
    scale = (panel.right - start - tail) / max([1, *reach])
    for number, (middle, value, color) in enumerate(zip(middles, values, colors, strict=True)):
        canvas.box(start, middle - thick / 2, max(value * scale, 1), thick, color)
        if aims:
            canvas.box(start + aims[number] * scale - 1, middle - thick / 2 - 3, 2, thick + 6, INK)
        canvas.text((start + reach[number] * scale + 8, middle + 4), words[number], FAINT, SMALL)


def columns(
    panel: Panel, names: Sequence[str], shares: Sequence[float], color: Color, mark: float | None = None
) -> None:
    """Standing bars of shares with their percents and, below, their bins; `mark` is a share drawn across."""
    canvas = panel.canvas
    floor, ceiling = panel.bottom - 16, panel.top + 14
    step = (panel.right - panel.left) / max(1, len(names))
    scale = (floor - ceiling) / max([*shares, mark or 0.0, 0.01])
    for number, (name, share) in enumerate(zip(names, shares, strict=True)):
        middle = panel.left + step * (number + 0.5)
        height = share * scale
        canvas.box(middle - step * 0.39, floor - height, step * 0.78, height, color)
        if share:
            words = f"{100 * share:.0f} %" if share >= 0.005 else "<1 %"
            # Words above a bar would stand on the mark.
            inside = mark is not None and height > 40
            place = (middle, floor - 8 if inside else floor - height - 5)
            canvas.text(place, words, PAPER if inside else FAINT, SMALL, align="center")
        canvas.text((middle, floor + 16), name, INK, SMALL, align="center")
    if mark is not None:
        canvas.box(panel.left, floor - mark * scale, panel.right - panel.left, 2, INK)
    canvas.box(panel.left, floor, panel.right - panel.left, 1, RULE)


def stacks(
    panel: Panel, names: Sequence[str], lines: Sequence[Sequence[Part]], counts: Sequence[int], below: float = 0
) -> None:
    """Lying bars of the same length, each cut into its parts; a part says its name where there is room."""
    canvas = panel.canvas
    room = names_width(canvas, names, panel.width / 3)
    middles = panel.rows(names, room, below)
    thick = thickness(middles, 20)
    start = panel.left + room
    length = panel.right - start - 52
    for middle, parts, count in zip(middles, lines, counts, strict=True):
        left = start
        for part in parts:
            wide = part.share * length
            canvas.box(left, middle - thick / 2, max(wide - 1, 0), thick, part.color)
            words = canvas.fitted(part.name, wide - 8, SMALL) if thick >= 14 else ""
            canvas.text((left + 4, middle + 4), words, _readable(part.color), SMALL)
            left += wide
        canvas.text((start + length + 7, middle + 4), f"n {count:,}", FAINT, SMALL)


def legend(panel: Panel, entries: Sequence[tuple[str, Color]], y: float) -> None:
    """Colors and what they stand for, in a line, and in more where they do not fit."""
    canvas, x = panel.canvas, panel.left
    for name, color in entries:
        wide = 16 + canvas.width(name, SMALL) + 16
        if x + wide > panel.right + 16:
            x, y = panel.left, y + 18
        canvas.box(x, y - 9, 10, 10, color)
        canvas.text((x + 16, y), name, FAINT, SMALL)
        x += wide


def _readable(color: Color) -> Color:
    red, green, blue = color
    return INK if 0.3 * red + 0.59 * green + 0.11 * blue > 150 else PAPER
