"""Annotated boxes and skeletons drawn on panoramas and crops, for a person to look at."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from jrdb_avr.schema.labels import SKELETON
from jrdb_avr.schema.method import Image
from jrdb_avr.schema.panorama import WIDTH


def draw_people(
    image: Image, sightings: Sequence[dict[str, Any]], poses: Iterable[dict[str, Any]] = (), left: float = 0.0
) -> Image:
    """A copy of a panorama, or of the crop whose left column is `left`, with boxes, their words and skeletons.

    A person on the seam is drawn on both sides. A pose is a row of the annotation table `poses`: `track`, `keypoints`.
    """
    image = np.array(image)
    for row in sightings:
        for shift in (-WIDTH, 0, WIDTH):
            _draw_box(image, row["x"] + shift - left, row)
    _draw_skeletons(image, left, sightings, poses)
    return image


def words(row: dict[str, Any]) -> str:
    """The label of a box: track, pose, group; a '?' after the track where the person is not clearly visible."""
    parts = [f"{row['track']}" + ("" if row["clear"] else "?")]
    if row["pose"]:
        parts.append(row["pose"])
    if row["cluster"] is not None:
        parts.append(f"g{row['cluster']}")
    return " ".join(parts)


def _draw_box(image: Image, x: float, row: dict[str, Any]) -> None:
    import cv2

    left, top = round(x), round(row["y"])
    right, bottom = round(x + row["w"]) - 1, round(row["y"] + row["h"]) - 1
    if right < 0 or left >= image.shape[1]:
        return
    color = _color(_number(row))
    cv2.rectangle(image, (left, top), (right, bottom), color, 1 if row["clear"] is False else 2)
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.4
    text = words(row)
    (width, height), _ = cv2.getTextSize(text, font, scale, 1)
    base = max(top - 3, height + 2)
    cv2.rectangle(image, (left, base - height - 2), (left + width + 2, base + 3), color, cv2.FILLED)
    cv2.putText(image, text, (left + 1, base), font, scale, (0, 0, 0), 1, cv2.LINE_AA)


def _draw_skeletons(
    image: Image, left: float, sightings: Iterable[dict[str, Any]], poses: Iterable[dict[str, Any]]
) -> None:
    """Draw lines and points, thin lines and rings for occluded points; points that are not visible have no place."""
    import cv2

    number = {row["track"]: _number(row) for row in sightings}
    for pose in poses:
        points = np.reshape(pose["keypoints"], (17, 3))
        code = points[:, 2]
        if not code.any():
            continue
        # Round the seam all points lie near the first that has a place.
        first = points[code > 0][0, 0]
        columns = first + (points[:, 0] - first + WIDTH / 2) % WIDTH - WIDTH / 2 - left
        color = _color(number.get(pose["track"], pose["track"]))
        for shift in (-WIDTH, 0, WIDTH):
            places = [(round(x + shift), round(y)) for x, y in zip(columns, points[:, 1], strict=True)]
            for i, j in SKELETON:
                if code[i] and code[j]:
                    cv2.line(image, places[i], places[j], color, 2 if code[i] == code[j] == 2 else 1, cv2.LINE_AA)
            for place, seen in zip(places, code, strict=True):
                if seen:
                    cv2.circle(image, place, 2, color, cv2.FILLED if seen == 2 else 1, cv2.LINE_AA)


def _number(row: dict[str, Any]) -> int:
    """The number that a person's color stands for: the group, else the track."""
    return int(row["track"] if row["cluster"] is None else row["cluster"])


def _color(number: int) -> tuple[int, int, int]:
    # The golden angle keeps the hues of neighbouring numbers far apart.
    red, green, blue = colorsys.hsv_to_rgb(number * 0.381966 % 1.0, 0.6, 1.0)
    return round(red * 255), round(green * 255), round(blue * 255)
