"""Boxes in a model's reply: four numbers under a key, read as the backbone's convention says.

Nothing is guessed: the convention is fixed before the first reply, numbers that do not fit it are refused with the
reason, and reversed corners are never swapped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import Box

from .conventions import CONTRACT, CONTRACT_KEY, SCALE, TOLERANCE, Convention, Order, Reading

# The numbers are not bounded: a server that keeps to the schema would bend a box of another scale into a wrong one,
# where the decoder says that it lies outside.
BOX_SCHEMA: Final[dict[str, Any]] = {"type": "array", "minItems": 4, "maxItems": 4, "items": {"type": "integer"}}


def box_key(entry: object, convention: Convention = CONTRACT, asked: str = CONTRACT_KEY) -> str:
    """The key under which an object holds its box: the one asked for, or the convention's alias if only that is there.

    An object without one, or with several, is left to `only_keys`: this returns the key asked for.
    """
    keys = [key for key in {asked: "", **convention.boxes} if isinstance(entry, dict) and key in entry]
    return keys[0] if len(keys) == 1 else asked


def read_box(
    value: object,
    width: int,
    height: int,
    convention: Convention = CONTRACT,
    key: str = CONTRACT_KEY,
    what: str = "box",
) -> Box:
    """Four numbers, written under `key`, as a box in pixels of an image of `width` x `height`. Raises DecodeError.

    Numbers outside the image by up to 2 % of its side are clipped; farther ones, and reversed or empty boxes, are
    refused. A key that the convention does not know is read as the contract's own.
    """
    return place_box(
        _numbers(value, convention.reading(key), what), width, height, convention.reading(key), convention, what
    )


def place_box(
    numbers: Sequence[float], width: int, height: int, reading: Reading, convention: Convention, what: str = "box"
) -> Box:
    """Four numbers under one reading as a box in pixels of the image. Raises DecodeError, as `read_box`."""
    across, down = full_sides(reading, convention, width, height)
    sides = (across, down) * 2 if reading.order == "xyxy" else (down, across) * 2
    if any(
        not -TOLERANCE * side <= number <= (1 + TOLERANCE) * side for number, side in zip(numbers, sides, strict=True)
    ):
        raise DecodeError(
            f"{what} has a coordinate outside 0..{across:g}" + (f" or 0..{down:g}" if down != across else "")
        )
    a, b, c, d = (min(max(number, 0), side) for number, side in zip(numbers, sides, strict=True))
    left, top, right, bottom = (a, b, c, d) if reading.order == "xyxy" else (b, a, d, c)
    if left >= right or top >= bottom:
        raise DecodeError(f"{what} has no area or reversed corners: the first corner is the upper left one")
    return Box(
        left * width / across, top * height / down, (right - left) * width / across, (bottom - top) * height / down
    )


def full_sides(reading: Reading, convention: Convention, width: int, height: int) -> tuple[float, float]:
    """The numbers that stand for the right and the lower edge of an image of `width` x `height`."""
    match reading.scale:
        case "thousandths":
            return SCALE, SCALE
        case "unit":
            return 1, 1
        case "pixels":
            return width, height
        case "resized":
            return convention.resized(width, height)


def _numbers(value: object, reading: Reading, what: str) -> list[float]:
    """Whole numbers, as the contract asks; any finite ones where the convention's scale is 0..1."""
    whole = reading.scale != "unit"
    kinds = (int,) if whole else (int, float)
    if not isinstance(value, list) or len(value) != 4 or any(type(v) not in kinds for v in value):
        raise DecodeError(f"{what} must be a list of four {'integers' if whole else 'numbers'}")
    if any(isinstance(v, float) and not math.isfinite(v) for v in value):
        raise DecodeError(f"{what} must be a list of four finite numbers")
    return value


def write_box(box: Box, width: int, height: int, order: Order = "xyxy") -> list[int]:
    """A box in image pixels as the four integers of the contract, clipped to the image."""
    corners = (
        box.x * SCALE / width,
        box.y * SCALE / height,
        (box.x + box.w) * SCALE / width,
        (box.y + box.h) * SCALE / height,
    )
    left, top, right, bottom = (min(max(round(v), 0), SCALE) for v in corners)
    return [left, top, right, bottom] if order == "xyxy" else [top, left, bottom, right]
