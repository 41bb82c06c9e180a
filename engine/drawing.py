"""Boxes drawn over panoramas and crops, for a person to look at."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from jrdb_avr.schema.method import Image
from jrdb_avr.schema.panorama import CROP, WIDTH, Box, to_crop

_BLACK: Final = (0, 0, 0)


def draw_on_panorama(panorama: Image, sightings: Iterable[dict[str, Any]]) -> Image:
    """A copy of a panorama with every sighting's box and words; a box over the seam shows on both sides."""
    image: Image = np.array(panorama)
    for row in sightings:
        for shift in (-WIDTH, 0, WIDTH):
            _draw(image, Box(row["x"] + shift, row["y"], row["w"], row["h"]), row)
    return image


def draw_on_crop(crop: Image, left: float, sightings: Iterable[dict[str, Any]]) -> Image:
    """A copy of the crop whose left column is `left`, with the boxes that lie in it."""
    image: Image = np.array(crop)
    for row in sightings:
        box = to_crop(Box(row["x"], row["y"], row["w"], row["h"]), left)
        if box.x < CROP and box.x + box.w > 0:
            _draw(image, box, row)
    return image


def words(row: dict[str, Any]) -> str:
    """What is written at a box: track, pose, group; a '?' behind the track where the person is no clear view."""
    parts = [f"{row['track']}" + ("" if row["clear"] else "?")]
    if row["pose"]:
        parts.append(row["pose"])
    if row["cluster"] is not None:
        parts.append(f"g{row['cluster']}")
    return " ".join(parts)


def _draw(image: Image, box: Box, row: dict[str, Any]) -> None:
    import cv2

    left, top = round(box.x), round(box.y)
    right, bottom = round(box.x + box.w) - 1, round(box.y + box.h) - 1
    if right < 0 or left >= image.shape[1]:
        return
    color = _color(row["cluster"] if row["cluster"] is not None else row["track"])
    cv2.rectangle(image, (left, top), (right, bottom), color, 1 if row["clear"] is False else 2)
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.4
    text = words(row)
    (width, height), _ = cv2.getTextSize(text, font, scale, 1)
    base = max(top - 3, height + 2)
    cv2.rectangle(image, (left, base - height - 2), (left + width + 2, base + 3), color, cv2.FILLED)
    cv2.putText(image, text, (left + 1, base), font, scale, _BLACK, 1, cv2.LINE_AA)


def _color(number: int) -> tuple[int, int, int]:
    # The golden angle keeps the hues of neighbouring numbers far apart.
    red, green, blue = colorsys.hsv_to_rgb(number * 0.381966 % 1.0, 0.6, 1.0)
    return round(red * 255), round(green * 255), round(blue * 255)
