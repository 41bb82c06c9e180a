"""Drawn pictures that test a server. Their contents are known, and no picture belongs to a question.

Each picture shows one *marked* rectangle on a plain background. The rectangle has a colour that a prompt can name. A
black and white grid distinguishes the rectangle from the plain shapes around it. The pictures depend only on a seed.
The simulated model gets the rectangle as the reference of the picture, and recognizes the prompt of such a picture by
the last line of the prompt.
"""

from __future__ import annotations

import functools
import random
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from jrdb_avr.agent.model.messages import Picture, jpeg_picture
from jrdb_avr.schema.method import Image
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box

CORNER_LINE: Final = "The corner, as one JSON object:"
BOX_LINE: Final = "The rectangle's box, as one JSON object:"
PANORAMA_LINE: Final = "The panorama's number, as one JSON object:"
CROP_LINE: Final = "The picture's frame, as one JSON object:"

CROP_SIZE: Final = (CROP, CROP)
PANORAMA_SIZE: Final = (WIDTH, HEIGHT)
"""Width and height in pixels of the panoramas that methods send."""

CORNERS: Final = {
    f"{down} {across}": Box(x, y, 150, 190)
    for down, y in (("upper", 15), ("lower", CROP - 205))
    for across, x in (("left", 15), ("right", CROP - 165))
}
"""A rectangle in each corner of a crop, as a box in pixels."""

_COLORS: Final = {
    "red": (185, 30, 30),
    "green": (30, 135, 45),
    "blue": (30, 70, 185),
    "yellow": (185, 165, 20),
    "purple": (125, 40, 145),
}
_GREY: Final = 105
_GRAIN: Final = 8
_SIDE_PX: Final = (60, 180)
_HEIGHT_PX: Final = (90, 300)
_DISTRACTORS: Final = 5
_APART_PX: Final = 6
_TRIES: Final = 200
_GRID: Final = 6
"""Number of the grid's cells along each side."""


@dataclass(frozen=True)
class DrawnPicture:
    """A picture with one marked rectangle.

    size: width and height of the picture in pixels. box: the rectangle in pixels. color: the colour of the rectangle.
    """

    picture: Picture
    size: tuple[int, int]
    box: Box
    color: str


@functools.cache
def drawn_picture(size: tuple[int, int], box: Box | None = None) -> Picture:
    """Draw a picture with one marked rectangle, or with no shape.

    Args:
        size: Width and height in pixels. If they are the size of a panorama, the picture gets noise. Its file is then
            as large as the file of a real panorama (650 kB).
        box: The rectangle in pixels. None draws no rectangle.

    Returns:
        The picture.
    """
    image = _plain(*size)
    if size == PANORAMA_SIZE:
        grain = np.random.default_rng(0).integers(-_GRAIN, _GRAIN + 1, (HEIGHT, WIDTH, 1), dtype=np.int8)
        # Sums of bytes wrap around, so adding a large byte darkens a pixel.
        image += grain.view(np.uint8)
    if box is not None:
        _marked(image, box, "red")
    return jpeg_picture(f"drawn {size} {box}", image, _reference(size, box))


def drawn_rectangles(n: int, seed: int) -> list[DrawnPicture]:
    """Draw pictures with one marked rectangle among plain shapes.

    Args:
        n: The number of pictures. Pictures of the size of crops and of panoramas alternate.
        seed: The seed of all random choices.

    Returns:
        The pictures.
    """
    rng = random.Random(seed)  # noqa: S311
    return [_drawn(rng, index, *(PANORAMA_SIZE if index % 2 else CROP_SIZE)) for index in range(n)]


def _drawn(rng: random.Random, index: int, width: int, height: int) -> DrawnPicture:
    image = _plain(width, height)
    color, *others = rng.sample(sorted(_COLORS), len(_COLORS))
    marked, *plain = _free_boxes(rng, width, height, 1 + _DISTRACTORS * (1 if width == height else 3))
    for box in plain:
        _shape(image, box, rng.choice(others), rng.random() < 0.5)
    _marked(image, marked, color)
    size = width, height
    picture = jpeg_picture(f"drawn {index:03d} {width}x{height}", image, _reference(size, marked))
    return DrawnPicture(picture, size, marked, color)


def _reference(size: tuple[int, int], box: Box | None) -> dict[str, Any]:
    return {"size": size, "rectangle": box}


def _free_boxes(rng: random.Random, width: int, height: int, n: int) -> list[Box]:
    """Return `n` random boxes that do not touch each other, or fewer if no more free space is found."""
    boxes: list[Box] = []
    tries = 0
    while len(boxes) < n and tries < _TRIES:
        w, h = rng.randint(*_SIDE_PX), rng.randint(*_HEIGHT_PX)
        x, y = rng.randint(0, width - w), rng.randint(0, height - h)
        tries += 1
        if not any(
            abs(x + w / 2 - b.x - b.w / 2) < (w + b.w) / 2 + _APART_PX
            and abs(y + h / 2 - b.y - b.h / 2) < (h + b.h) / 2 + _APART_PX
            for b in boxes
        ):
            boxes.append(Box(x, y, w, h))
            tries = 0
    return boxes


def _plain(width: int, height: int) -> Image:
    return np.full((height, width, 3), _GREY, np.uint8)


def _shape(image: Image, box: Box, color: str, round_: bool) -> None:
    import cv2

    x, y, w, h = (int(v) for v in box)
    if round_:
        cv2.ellipse(image, (x + w // 2, y + h // 2), (w // 2, h // 2), 0, 0, 360, _COLORS[color], -1)
    else:
        cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), _COLORS[color], -1)


def _marked(image: Image, box: Box, color: str) -> None:
    """Draw a rectangle with a grid of black and white cells in its middle."""
    _shape(image, box, color, False)
    x, y, w, h = (int(v) for v in box)
    cells = np.indices((_GRID, _GRID)).sum(axis=0) % 2 * 255
    side = min(w, h) // (2 * _GRID)
    grid = cells.repeat(side, axis=0).repeat(side, axis=1)[:, :, None]
    top, left = y + (h - grid.shape[0]) // 2, x + (w - grid.shape[1]) // 2
    image[top : top + grid.shape[0], left : left + grid.shape[1]] = grid
