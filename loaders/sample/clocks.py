"""Timestamps of images and clouds, and the calibration of the cameras: files that are no labels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.schema.rules import FPS

from .world import World, rng_of

_CAMERAS: Final = (0, 2, 4, 6, 8)
_LIDARS: Final = ("upper_velodyne", "lower_velodyne")
_EPOCH: Final = 1_549_000_000
"""Seconds: the sample's sequences were taken in the weeks after this."""
_LONGER: Final = 3
"""The timestamps reach some frames further than the labels."""


def frames_img(world: World) -> Iterator[bytes]:
    """`timestamps/<sequence>/frames_img.json`."""
    yield _file(world, "cameras", [(f"image_{n}", f"images/image_{n}/{world.name}/{{}}.jpg") for n in _CAMERAS], 0.0)


def frames_pc(world: World) -> Iterator[bytes]:
    """`timestamps/<sequence>/frames_pc.json`; clouds come up to 40 ms after the images."""
    sensors = [(name, f"pointclouds/{name}/{world.name}/{{}}.pcd") for name in _LIDARS]
    yield _file(world, "pointclouds", sensors, 0.02)


def _file(world: World, key: str, sensors: list[tuple[str, str]], late: float) -> bytes:
    rng = rng_of(world.seed, world.name, "timestamps", key)
    count = world.frames + _LONGER
    start = _EPOCH + int(rng_of(world.seed, world.name, "epoch").integers(0, 6_000_000))
    times = start + np.arange(count) / FPS + late + rng.uniform(-0.004, 0.004, count)
    rows: list[dict[str, Any]] = []
    for frame, time in enumerate(np.round(times, 6).tolist()):
        parts = [
            {"name": name, "url": url.format(f"{frame:06d}"), "timestamp": round(time + 0.0001 * k, 6)}
            for k, (name, url) in enumerate(sensors)
        ]
        rows.append({"frame_id": frame, "timestamp": time, key: parts})
    return msgspec.json.encode({"data": rows})


def calibration_files() -> dict[str, str]:
    """Name -> text of `calibration/*.yaml`, laid out like the published ones; the numbers are the sample's own."""
    cameras = ["stitching:", "  radius: 3360000", "  rotation: 0", "  scalewidth: 1831", "  crop: 1", "cameras:"]
    for number in range(10):
        cameras += [
            f"  sensor_{number}:",
            "    width: 752",
            "    height: 480",
            "    D: -0.34 0.16 0.0001 -0.0001 -0.045",
            "    # K = fx 0 cx, 0 fy cy, 0 0 1",
            "    K: >",
            f"      {480.0 + 0.5 * number:g} 0 {355.0 + number:g}",
            f"      0 {482.9 + 0.5 * number:g} {209.4 - number:g}",
            "      0 0 1",
            "    R: >",
            "      1 0 0",
            "      0 1 0",
            "      0 0 1",
            "    T: 0 0 -56.9",
        ]
    lidars = [
        "%YAML 1.2",
        "---",
        "lidar:",
        "  upper2ego:",
        "  - [1.0, 0.0, 0.0, 0.0]",
        "  - [0.0, 1.0, 0.0, 0.0]",
        "  - [0.0, 0.0, 1.0, 0.33529]",
        "  - [0.0, 0.0, 0.0, 1.0]",
    ]
    for number in _CAMERAS:
        lidars += [
            f"sensor_{number}:",
            "  D: [-0.34, 0.16, 0.0001, -0.0001, -0.045]",
            "  distorted_img_K:",
            f"  - [{480.0 + 0.5 * number:g}, 0.0, {355.0 + number:g}]",
            f"  - [0.0, {482.9 + 0.5 * number:g}, {209.4 - number:g}]",
            "  - [0.0, 0.0, 1.0]",
        ]
    defaults = [
        "calibrated:",
        "  lidar_upper_to_rgb:",
        "    translation: [0, 0, -0.33529]",
        "    rotation: [0, 0, 0.085]",
        "  lidar_lower_to_rgb:",
        "    translation: [0, 0, 0.13511]",
        "    rotation: [0, 0, 0]",
        "image:",
        "  width: 3760",
        "  height: 480",
        "  stitched_image_offset: 1880",
    ]
    texts = {"cameras": cameras, "lidars": lidars, "defaults": defaults}
    return {f"{name}.yaml": "\n".join(lines) + "\n" for name, lines in texts.items()}
