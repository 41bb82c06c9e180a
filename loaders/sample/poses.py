"""`labels_2d_pose_stitched_coco/<sequence>.json`: seventeen keypoints of the figures that are drawn."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.panorama import HEIGHT, WIDTH

from .labels import annotated, occlusion, spans
from .skeleton import JOINTS, L_EYE, LEFT_SIDE, R_EYE, RIGHT_SIDE
from .world import World, rng_of, turned

_EDGES: Final = (
    *((1, 2), (0, 4), (3, 4), (8, 10), (5, 7), (10, 13), (14, 16), (4, 5)),
    *((7, 12), (4, 8), (3, 6), (13, 15), (11, 14), (6, 9), (8, 11)),
)
_SIDEWAYS: Final = 0.8
"""Seen so far from the side, the limbs behind the body are covered by it."""
_AWAY: Final = -0.25
"""Turned so far away, the eyes cannot be seen."""


def visibility(world: World) -> Ints:
    """(frames, people, 17): 0 not visible, 1 occluded, 2 visible."""
    side, toward = turned(world.motion)
    out = np.where(world.joint_covered, 1, 2)
    for limbs, behind in ((RIGHT_SIDE, side < -_SIDEWAYS), (LEFT_SIDE, side > _SIDEWAYS)):
        out[..., limbs] = np.where(behind[..., None], np.minimum(out[..., limbs], 1), out[..., limbs])
    eyes = [R_EYE, L_EYE]
    out[..., eyes] = np.where((toward < _AWAY)[..., None], 0, out[..., eyes])
    rows = world.joints[..., 1]
    return np.where((rows < 0) | (rows >= HEIGHT), 0, out).astype(np.int64)


def pose_file(world: World) -> Iterator[bytes]:
    """The file's text, in parts. Columns are those of the panorama; a pose over the seam has some at either edge."""
    rng = rng_of(world.seed, world.name, "poses")
    hidden = occlusion(world) >= 2
    posed = annotated(world) & (occlusion(world) < 3) & ~spans(rng, hidden, 0.004, 10, 60)
    bare = spans(rng, posed & hidden, 0.0004, 1, 3)
    shift = 1 + world.name.endswith(("_1", "_3"))
    # The last frame is missing in some files.
    frames = world.frames - world.name.endswith(("_0", "_2"))
    yield b'{"images":'
    yield msgspec.json.encode([_image(world.name, frame, shift) for frame in range(frames)])
    yield b',"annotations":['
    seen = visibility(world)
    number = 0
    for frame in range(frames):
        people = np.flatnonzero(posed[frame])
        points = np.empty((len(people), len(JOINTS), 3), np.int64)
        points[..., 2] = seen[frame, people]
        points[..., :2] = np.floor(world.joints[frame, people])
        points[..., 0] %= WIDTH
        points[..., :2] *= points[..., 2:] > 0
        rows = []
        told = np.count_nonzero(points[..., 2], axis=1).tolist()
        for i, keypoints, count in zip(people.tolist(), points.reshape(len(people), 51).tolist(), told, strict=True):
            row: dict[str, Any] = {
                "id": number,
                "image_id": frame + shift,
                "track_id": world.people[i].track,
                "category_id": 1,
                "keypoints": keypoints,
                "num_keypoints": count,
            }
            if bare[frame, i]:
                del row["keypoints"]
            rows.append(row)
            number += 1
        yield b"," * (number > len(rows) > 0) + msgspec.json.encode(rows)[1:-1]
    category = {"id": 1, "name": "person", "keypoints": JOINTS, "skeleton": [[a + 1, b + 1] for a, b in _EDGES]}
    yield b'],"categories":' + msgspec.json.encode([category]) + b"}"


def _image(sequence: str, frame: int, shift: int) -> dict[str, Any]:
    # The width is that of one camera, as in the published files.
    name = f"image_stitched/{sequence}/{frame:06d}.jpg"
    return {"id": frame + shift, "width": WIDTH // 5, "height": HEIGHT, "file_name": name}
