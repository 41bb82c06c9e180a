"""Write all label files and timestamps of a simulated sequence, as parts of the text of each file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.loaders.synthetic.box_files import Quirks, _Record, frames_2d, frames_3d
from jrdb_avr.loaders.synthetic.coco_files import panoptic_file, pose_file
from jrdb_avr.loaders.synthetic.social_files import SocialFiles
from jrdb_avr.loaders.synthetic.world import World
from jrdb_avr.schema.rules import FPS

_BOXES_2D: Final = (
    "labels/labels_2d_stitched/{}.json",
    "labels/labels_2d_activity_social_stitched/{}.json",
    "labels/labels_2d_stitched_new_version/{}.json",
)
"""Files of 2D boxes, and the social and reasoning files, which have the same records with more keys."""
_BOXES_3D: Final = "labels/labels_3d/{}.json"

_CAMERAS: Final = (0, 2, 4, 6, 8)
_LIDARS: Final = ("upper_velodyne", "lower_velodyne")
_EPOCH: Final = 1_549_000_000
"""Start of the weeks of the sample's recordings, in seconds since the epoch."""
_LONGER: Final = 3
"""Number of frames with timestamps after the last labelled frame."""


def label_texts(world: World, quirks: Quirks, social: SocialFiles) -> Iterator[tuple[str, bytes]]:
    """Yield parts of the files: the file's path, with the sequence's name in the braces, and the next part of its text.

    A layer is a function of the world that makes its text; a further one is another entry here.
    """
    cameras = {f"image_{n}": f"images/image_{n}/{world.name}/{{}}.jpg" for n in _CAMERAS}
    lidars = {name: f"pointclouds/{name}/{world.name}/{{}}.pcd" for name in _LIDARS}
    layers = {
        "labels/labels_2d_pose_stitched_coco/{}.json": pose_file(world),
        "labels/labels_2d_panoptic_stitched_CW/{}.json": panoptic_file(world),
        "timestamps/{}/frames_img.json": iter([_timestamps(world, "cameras", cameras, 0.0)]),
        # Clouds come up to 40 ms after the images.
        "timestamps/{}/frames_pc.json": iter([_timestamps(world, "pointclouds", lidars, 0.02)]),
    }
    for path, parts in layers.items():
        for part in parts:
            yield path, part
    boxes = ((item.key, (item.records + item.foreign, *social.records(item))) for item in frames_2d(world, quirks))
    yield from _by_frame(_BOXES_2D, boxes)
    yield from _by_frame((_BOXES_3D,), ((key, (rows,)) for key, rows in frames_3d(world, quirks)))


def _by_frame(
    paths: tuple[str, ...], frames: Iterator[tuple[str, tuple[list[_Record], ...]]]
) -> Iterator[tuple[str, bytes]]:
    """Yield parts of files with one list of records per frame. Only one frame is in memory at a time."""
    begin = b'{"labels":{'
    for key, lists in frames:
        for path, records in zip(paths, lists, strict=True):
            yield path, b'%b"%b":%b' % (begin, key.encode(), msgspec.json.encode(records))
        begin = b","
    for path in paths:
        yield path, b"}}"


def _timestamps(world: World, key: str, urls: dict[str, str], late: float) -> bytes:
    """Return the text of a file of timestamps, with one entry per frame and sensor."""
    rng = world.rng("timestamps", key)
    count = world.frames + _LONGER
    start = _EPOCH + int(world.rng("epoch").integers(0, 6_000_000))
    times = start + np.arange(count) / FPS + late + rng.uniform(-0.004, 0.004, count)
    rows: list[dict[str, Any]] = []
    for frame, time in enumerate(np.round(times, 6).tolist()):
        parts = [
            {"name": name, "url": url.format(f"{frame:06d}"), "timestamp": round(time + 0.0001 * k, 6)}
            for k, (name, url) in enumerate(urls.items())
        ]
        rows.append({"frame_id": frame, "timestamp": time, key: parts})
    return msgspec.json.encode({"data": rows})
