"""What stands round the people of a sequence: walls with landmarks above, a tiled floor below; no pixel is bright."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.synthetic.world import FLOOR
from jrdb_avr.schema.panorama import HEIGHT, WIDTH, row_of_height

Image = npt.NDArray[np.uint8]
Ids = npt.NDArray[np.uint16]
Color = tuple[int, int, int]

_WALLS: Final[tuple[Color, ...]] = ((150, 145, 132), (132, 145, 150), (150, 138, 120), (138, 148, 135))
_FLOORS: Final[tuple[Color, ...]] = ((118, 108, 96), (104, 108, 112), (112, 112, 98), (100, 96, 92))

FOOT: Final = 240
"""Row where the walls meet the floor."""

_SLOTS: Final = 16
_KINDS: Final = ("window", "door", "column", "poster", "vegetation")


@dataclass(frozen=True)
class Backdrop:
    """A panorama without people (480, 3760, 3), and the segment of each of its pixels: 1 + its place in
    `categories`."""

    image: Image
    ids: Ids
    categories: tuple[str, ...]


def backdrop(rng: np.random.Generator) -> Backdrop:
    """The surroundings of a sequence, with the robot turned to where it starts."""
    wall, floor = _WALLS[int(rng.integers(len(_WALLS)))], _FLOORS[int(rng.integers(len(_FLOORS)))]
    image = np.empty((HEIGHT, WIDTH, 3), np.float32)
    rows = np.arange(HEIGHT, dtype=np.float32)[:, None, None]
    image[:FOOT] = np.array(wall, np.float32) * (0.72 + 0.3 * rows[:FOOT] / FOOT)
    image[FOOT:] = np.array(floor, np.float32) * (0.86 + 0.3 * (rows[FOOT:] - FOOT) / (HEIGHT - FOOT))
    # Joints of the tiles: rings at equal distances, and spokes.
    for meters in np.arange(1.0, 24.0, 1.0):
        row = int(row_of_height(FLOOR, meters))
        if FOOT < row < HEIGHT:
            image[row] *= 0.9
    canvas = np.clip(image, 0, 175).astype(np.uint8)
    for column in range(0, WIDTH, 188):
        cv2.line(canvas, (column, FOOT), (column, HEIGHT), (floor[0] - 14, floor[1] - 14, floor[2] - 14), 1)
    ids = np.empty((HEIGHT, WIDTH), np.uint16)
    ids[:FOOT], ids[FOOT:] = 1, 2
    categories = ["wall", "floor/walking_path"]
    for slot in range(_SLOTS):
        place = slot * (WIDTH // _SLOTS) + int(rng.integers(10, 60))
        kind = int(rng.integers(len(_KINDS)))
        tint = tuple(int(c) for c in rng.integers(70, 150, 3))
        categories.append(_KINDS[kind])
        segment = len(categories)
        _landmark(canvas, kind, place, slot, tint, (wall[0] - 45, wall[1] - 45, wall[2] - 45))
        _landmark(ids, kind, place, slot, *[(segment,) * 3] * 2)
    noise = rng.normal(0, 1, (HEIGHT // 8, WIDTH // 8)).astype(np.float32)
    # Joined at the seam before it is blown up, so that no edge shows there.
    joined = np.hstack([noise[:, -1:], noise, noise[:, :1]])
    grain = cv2.resize(joined, (WIDTH + 16, HEIGHT), interpolation=cv2.INTER_LINEAR)
    grained = canvas + grain[:, 8:-8, None] * 1.5
    return Backdrop(np.asarray(np.clip(grained, 0, 180), np.uint8), ids, tuple(categories))


def _landmark(canvas: npt.NDArray[Any], kind: int, x: int, slot: int, tint: Any, dark: Any) -> None:
    """A window, door, column, poster or plant on the wall; into the segments where both colours are one number."""
    segment = canvas.ndim == 2
    if kind == 0:
        cv2.rectangle(canvas, (x, 60), (x + 130, 150), tint if segment else (130, 150, 168), -1)
        cv2.rectangle(canvas, (x, 60), (x + 130, 150), dark, 3)
        cv2.line(canvas, (x + 65, 60), (x + 65, 150), dark, 2)
    elif kind == 1:
        cv2.rectangle(canvas, (x, 120), (x + 60, FOOT - 1), tint, -1)
        cv2.rectangle(canvas, (x, 120), (x + 60, FOOT - 1), dark, 2)
        cv2.circle(canvas, (x + 50, 185), 3, dark, -1)
    elif kind == 2:
        cv2.rectangle(canvas, (x, 0), (x + 34, FOOT - 1), dark, -1)
    elif kind == 3:
        cv2.rectangle(canvas, (x, 80), (x + 100, 150), tint, -1)
        if not segment:
            cv2.putText(canvas, str(slot), (x + 20, 135), cv2.FONT_HERSHEY_SIMPLEX, 1.5, (40, 40, 40), 3)
    else:
        cv2.rectangle(canvas, (x + 36, 170), (x + 48, FOOT - 1), tint if segment else (80, 60, 45), -1)
        cv2.ellipse(canvas, (x + 42, 130), (40, 55), 0, 0, 360, tint if segment else (60, 95, 60), -1)
