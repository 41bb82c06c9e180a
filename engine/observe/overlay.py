"""Annotated boxes and skeletons drawn on panoramas and crops."""

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
    """Draw people on a copy of a picture. A person who crosses the seam is drawn at both ends of a panorama.

    Args:
        image: A panorama or a crop (height, width, 3).
        sightings: One row per person in the frame, with the box (in stitched pixels), the pose and the group of the
            person.
        poses: Rows of the table `poses` for the frame.
        left: Left column of the crop in stitched pixels, or 0 for a panorama.

    Returns:
        The copy, with boxes, labels and skeletons.
    """
    image = np.array(image)
    for row in sightings:
        for shift in (-WIDTH, 0, WIDTH):
            _draw_box(image, row["x"] + shift - left, row)
    _draw_skeletons(image, left, sightings, poses)
    return image


def label_of(row: dict[str, Any]) -> str:
    """Return the text beside a person's box.

    Args:
        row: A sighting with pose and group (`cluster`).

    Returns:
        Track id, pose and group. A '?' follows the track id if the person is not in clear view.
    """
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
    color = _color(_color_key(row))
    cv2.rectangle(image, (left, top), (right, bottom), color, 1 if row["clear"] is False else 2)
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.4
    text = label_of(row)
    (width, height), _ = cv2.getTextSize(text, font, scale, 1)
    base = max(top - 3, height + 2)
    cv2.rectangle(image, (left, base - height - 2), (left + width + 2, base + 3), color, cv2.FILLED)
    cv2.putText(image, text, (left + 1, base), font, scale, (0, 0, 0), 1, cv2.LINE_AA)


def _draw_skeletons(
    image: Image, left: float, sightings: Iterable[dict[str, Any]], poses: Iterable[dict[str, Any]]
) -> None:
    """Draw the visible points of skeletons and the lines between them. Occluded points get rings and thin lines."""
    import cv2

    keys = {row["track"]: _color_key(row) for row in sightings}
    for pose in poses:
        points = np.reshape(pose["keypoints"], (17, 3))
        code = points[:, 2]
        if not code.any():
            continue
        # A person may cross the seam, so all points are moved to the side of the first visible point.
        first = points[code > 0][0, 0]
        columns = first + (points[:, 0] - first + WIDTH / 2) % WIDTH - WIDTH / 2 - left
        color = _color(keys.get(pose["track"], pose["track"]))
        for shift in (-WIDTH, 0, WIDTH):
            corners = [(round(x + shift), round(y)) for x, y in zip(columns, points[:, 1], strict=True)]
            for i, j in SKELETON:
                if code[i] and code[j]:
                    cv2.line(image, corners[i], corners[j], color, 2 if code[i] == code[j] == 2 else 1, cv2.LINE_AA)
            for point, visibility in zip(corners, code, strict=True):
                if visibility:
                    cv2.circle(image, point, 2, color, cv2.FILLED if visibility == 2 else 1, cv2.LINE_AA)


def _color_key(row: dict[str, Any]) -> int:
    """Return the number that selects a person's color: the group's id, or the track id if there is no group."""
    return int(row["track"] if row["cluster"] is None else row["cluster"])


def _color(key: int) -> tuple[int, int, int]:
    # Steps of the golden angle give consecutive keys hues that are far apart.
    red, green, blue = colorsys.hsv_to_rgb(key * 0.381966 % 1.0, 0.6, 1.0)
    return round(red * 255), round(green * 255), round(blue * 255)
