"""Drawn pictures that test a server. Their contents are known, and no picture belongs to a question.

Each picture shows one red rectangle on a plain background. The pictures depend only on a seed. The simulated model gets
the rectangle as the reference of the picture, and recognizes the prompt of such a picture by its last line.
"""

from __future__ import annotations

import functools
import random
from typing import Final, NamedTuple

import numpy as np

from jrdb_avr.agent.model.messages import Picture, jpeg_picture
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

_RED: Final = (185, 30, 30)
_GREY: Final = 105
_GRAIN: Final = 8


class DrawnPicture(NamedTuple):
    """A picture with one red rectangle.

    size: width and height of the picture in pixels. box: the rectangle in pixels.
    """

    picture: Picture
    size: tuple[int, int]
    box: Box


@functools.cache
def drawn_picture(size: tuple[int, int], box: Box | None = None) -> Picture:
    """Draw a picture with one red rectangle, or with no shape.

    Args:
        size: Width and height in pixels. If they are the size of a panorama, the picture gets noise. Its file is then
            as large as the file of a real panorama (650 kB).
        box: The rectangle in pixels. None draws no rectangle.

    Returns:
        The picture.
    """
    return _drawn(f"drawn {size} {box}", size, box, noisy=size == PANORAMA_SIZE)


def drawn_rectangles(n: int, seed: int) -> list[DrawnPicture]:
    """Draw pictures with one red rectangle each.

    Args:
        n: The number of pictures. Pictures of the size of crops and of panoramas alternate.
        seed: The seed of all random choices.

    Returns:
        The pictures.
    """
    rng = random.Random(seed)  # noqa: S311
    pictures = []
    for index in range(n):
        width, height = size = PANORAMA_SIZE if index % 2 else CROP_SIZE
        w, h = rng.randint(60, 180), rng.randint(90, 300)
        box = Box(rng.randint(0, width - w), rng.randint(0, height - h), w, h)
        pictures.append(DrawnPicture(_drawn(f"drawn {index:03d} {width}x{height}", size, box), size, box))
    return pictures


def _drawn(name: str, size: tuple[int, int], box: Box | None, noisy: bool = False) -> Picture:
    image = np.full((size[1], size[0], 3), _GREY, np.uint8)
    if noisy:
        grain = np.random.default_rng(0).integers(-_GRAIN, _GRAIN + 1, (*image.shape[:2], 1), dtype=np.int8)
        # Sums of bytes wrap around, so adding a large byte darkens a pixel.
        image += grain.view(np.uint8)
    if box is not None:
        x, y, w, h = (int(v) for v in box)
        image[y : y + h, x : x + w] = _RED
    return jpeg_picture(name, image, {"size": size, "rectangle": box})
