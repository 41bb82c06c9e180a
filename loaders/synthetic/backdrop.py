"""Surroundings of the people of a sequence: walls with landmarks above, a tiled floor below."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from jrdb_avr.loaders.synthetic.figures import OWNER, Canvas
from jrdb_avr.loaders.synthetic.script import Rng, one_of
from jrdb_avr.loaders.synthetic.shapes import Color, shade
from jrdb_avr.loaders.synthetic.world import FLOOR
from jrdb_avr.schema.panorama import HEIGHT, WIDTH, row_of_height

_WALLS: Final[tuple[Color, ...]] = ((150, 145, 132), (132, 145, 150), (150, 138, 120), (138, 148, 135))
_FLOORS: Final[tuple[Color, ...]] = ((118, 108, 96), (104, 108, 112), (112, 112, 98), (100, 96, 92))

_FOOT: Final = 240
"""Row of the line between walls and floor."""
_SLOTS: Final = 16
_KINDS: Final = ("window", "door", "column", "poster", "vegetation")


class Backdrop:
    """Panorama of a sequence without people, before the robot turns.

    Attributes:
        image: Pixels, (480, 3760, 3).
        ids: Segment of each pixel: 1 + the index of its category in `categories`.
    """

    def __init__(self, rng: Rng) -> None:
        wall, floor = one_of(rng, _WALLS), one_of(rng, _FLOORS)
        image = np.empty((HEIGHT, WIDTH, 3), np.float32)
        rows = np.arange(HEIGHT, dtype=np.float32)[:, None, None]
        image[:_FOOT] = np.array(wall, np.float32) * (0.72 + 0.3 * rows[:_FOOT] / _FOOT)
        image[_FOOT:] = np.array(floor, np.float32) * (0.86 + 0.3 * (rows[_FOOT:] - _FOOT) / (HEIGHT - _FOOT))
        # Joints of the tiles: rings at equal distances, and spokes.
        for meters in np.arange(1.0, 24.0, 1.0):
            row = int(row_of_height(FLOOR, meters))
            if _FOOT < row < HEIGHT:
                image[row] *= 0.9
        canvas = Canvas(np.clip(image, 0, 175).astype(np.uint8))
        for column in range(0, WIDTH, 188):
            canvas.lines([(column, _FOOT), (column, HEIGHT)], shade(floor, -14))
        self.ids = np.empty((HEIGHT, WIDTH), np.uint16)
        self.ids[:_FOOT], self.ids[_FOOT:] = 1, 2
        self.categories = ["wall", "floor/walking_path"]
        for slot in range(_SLOTS):
            x = slot * (WIDTH // _SLOTS) + int(rng.integers(10, 60))
            kind = one_of(rng, _KINDS)
            red, green, blue = rng.integers(70, 150, 3).tolist()
            self.categories.append(kind)
            for surface in (canvas, Canvas(self.ids, {OWNER: len(self.categories)})):
                _landmark(surface, kind, x, (red, green, blue), shade(wall, -45))
            if kind == "poster":
                cv2.putText(canvas.image, str(slot), (x + 20, 135), cv2.FONT_HERSHEY_SIMPLEX, 1.5, (40, 40, 40), 3)
        noise = rng.normal(0, 1, (HEIGHT // 8, WIDTH // 8)).astype(np.float32)
        # Joined at the seam before it is blown up, so that no edge shows there.
        joined = np.hstack([noise[:, -1:], noise, noise[:, :1]])
        grain = cv2.resize(joined, (WIDTH + 16, HEIGHT), interpolation=cv2.INTER_LINEAR)
        grained = canvas.image + grain[:, 8:-8, None] * 1.5
        self.image = np.asarray(np.clip(grained, 0, 180), np.uint8)


def _landmark(canvas: Canvas, kind: str, x: int, tint: Color, dark: Color) -> None:
    """Draw a window, door, column, poster or plant on the wall."""
    match kind:
        case "window":
            canvas.rectangle((x, 60), (x + 130, 150), (130, 150, 168))
            canvas.rectangle((x, 60), (x + 130, 150), dark, width=3)
            canvas.lines([(x + 65, 60), (x + 65, 150)], dark, width=2)
        case "door":
            canvas.rectangle((x, 120), (x + 60, _FOOT - 1), tint)
            canvas.rectangle((x, 120), (x + 60, _FOOT - 1), dark, width=2)
            canvas.circle((x + 50, 185), 3, dark)
        case "column":
            canvas.rectangle((x, 0), (x + 34, _FOOT - 1), dark)
        case "poster":
            canvas.rectangle((x, 80), (x + 100, 150), tint)
        case _:
            canvas.rectangle((x + 36, 170), (x + 48, _FOOT - 1), (80, 60, 45))
            canvas.ellipse((x + 42, 130), (40, 55), (60, 95, 60))
