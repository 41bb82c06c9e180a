"""Writes a sample root: one sequence at a time, each from its own seed, in worker processes.

A layer is a function of the simulated world that gives its file's text in parts; a further one is another entry in
`_LAYERS`. The box files share their records, which are made once.

The sample's shares beside those of JRDB.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

import msgspec
import numpy as np

from jrdb_avr.loaders.synthetic.box_files import (
    HARD,
    Quirks,
    annotated,
    difficulty,
    frames_2d,
    frames_3d,
    lidar_points,
    occlusion,
)
from jrdb_avr.loaders.synthetic.coco_files import category_ids, panoptic_file, pose_file
from jrdb_avr.loaders.synthetic.label_files import Social, calibration_files, frames_img, frames_pc
from jrdb_avr.loaders.synthetic.pictures import image_frames, write_images
from jrdb_avr.loaders.synthetic.script import NONE
from jrdb_avr.loaders.synthetic.world import World, build
from jrdb_avr.queries.workers import map_shards
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.rules import KEYFRAME_STEP

_PLACES: Final = ("plaza", "cafe", "hall", "library", "street", "lobby", "atrium", "campus", "market")

_LAYERS: Final[dict[str, Callable[[World], Iterator[bytes]]]] = {
    "labels/labels_2d_pose_stitched_coco/{}.json": pose_file,
    "labels/labels_2d_panoptic_stitched_CW/{}.json": panoptic_file,
    "timestamps/{}/frames_img.json": frames_img,
    "timestamps/{}/frames_pc.json": frames_pc,
}
"""Path of each layer's file, with the sequence's name in the braces, and what makes its text."""

_BOXES_2D: Final = "labels/labels_2d_stitched/{}.json"
_BOXES_3D: Final = "labels/labels_3d/{}.json"
_SOCIAL: Final = "labels/labels_2d_activity_social_stitched/{}.json"
_REASONING: Final = "labels/labels_2d_stitched_new_version/{}.json"

FULL_SCALE: Final = (
    *((1079, 12), (715, 11), (789, 13), (1604, 42), (1222, 23), (638, 18), (1663, 7), (425, 5), (791, 23)),
    *((787, 7), (569, 11), (1659, 15), (1668, 43), (1177, 9), (1006, 20), (1227, 29), (503, 18), (498, 21)),
    *((1651, 27), (434, 7), (1399, 13), (498, 13), (475, 8), (642, 30), (1222, 107), (1661, 125), (1659, 75)),
)
"""Frames and people in view of 27 sequences, as uneven as those of the JRDB test split."""


@dataclass(frozen=True)
class Order:
    """One sequence to write."""

    root: str
    name: str
    seed: int
    frames: int
    people: int
    images: str


@dataclass(frozen=True)
class Written:
    """What one sequence holds, for the summary. Shares are counted over 2D boxes (hard labels: over labels at
    keyframes; gaps: over people, at keyframes; points: over people in view)."""

    name: str
    frames: int
    people: int
    images: int
    boxes: int
    occluded: int
    labels: int
    hard_labels: int
    tracks: int
    tracks_with_gaps: int
    solid: int
    without_points: int
    interactions: int


def sequence_name(index: int) -> str:
    """The name of the sample's sequence number `index`, from 0."""
    return f"sample-{_PLACES[index % len(_PLACES)]}-{index // len(_PLACES) + 1:02d}_{index % 4}"


def plan(root: Path, sizes: list[tuple[int, int]], seed: int, images: str) -> list[Order]:
    """Orders for sequences of these (frames, people); `images` as in `render.image_frames`.

    Raises InputError where the folder exists and is not empty.
    """
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise InputError(f"{root} exists and is not empty: name a new folder", file=str(root))
    return [
        Order(str(root), sequence_name(i), seed, frames, people, images) for i, (frames, people) in enumerate(sizes)
    ]


def write(orders: list[Order], workers: int) -> Iterator[Written]:
    """Write the sequences; yields each as it is done, in no fixed order."""
    for name, text in calibration_files().items():
        for folder in sorted({Path(order.root) / "calibration" for order in orders}):
            folder.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)
    for _, written in map_shards(write_sequence, orders, workers, lambda order: order.frames * order.people):
        yield written


def write_sequence(order: Order) -> Written:
    """Simulate one sequence and write its files."""
    world = build(order.name, order.seed, order.frames, order.people)
    root = Path(order.root)
    for name, layer in _LAYERS.items():
        with _open(root, name, order.name) as file:
            file.writelines(layer(world))
    quirks = Quirks(world)
    interactions = _write_boxes(root, world, quirks)
    images = image_frames(world, order.images)
    if images:
        write_images(world, images, root / "images" / "image_stitched" / order.name)
    return _count(world, quirks, len(images), interactions)


def _open(root: Path, name: str, sequence: str) -> BinaryIO:
    path = root / name.format(sequence)
    path.parent.mkdir(parents=True, exist_ok=True)
    return path.open("wb")


def _write_boxes(root: Path, world: World, quirks: Quirks) -> int:
    """The files of one list of records per frame, one frame in memory at a time; returns the number of interactions."""
    social = Social(world, quirks, category_ids(world))
    with ExitStack() as stack:
        flat, more, most, solid = (
            _FrameFile(stack.enter_context(_open(root, name, world.name)))
            for name in (_BOXES_2D, _SOCIAL, _REASONING, _BOXES_3D)
        )
        for one in frames_2d(world, quirks):
            flat.add(one.key, one.records + one.foreign)
            more.add(one.key, social.social(one))
            most.add(one.key, social.reasoning(one))
        for key, rows in frames_3d(world, quirks):
            solid.add(key, rows)
        for file in (flat, more, most, solid):
            file.end()
    return social.interactions


class _FrameFile:
    """A file of lists of records by frame key, written frame by frame."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._next = b'{"labels":{'

    def add(self, key: str, records: list[dict[str, Any]]) -> None:
        self._file.write(b'%b"%b":%b' % (self._next, key.encode(), msgspec.json.encode(records)))
        self._next = b","

    def end(self) -> None:
        self._file.write(self._next.removesuffix(b",") + b"}}")


def _count(world: World, quirks: Quirks, images: int, interactions: int) -> Written:
    here = annotated(world)
    key = np.arange(KEYFRAME_STEP, world.frames, KEYFRAME_STEP)
    level, _ = difficulty(world)
    told = np.concatenate([np.zeros((world.frames, len(world.people), 1), np.int64), world.actions], axis=2) != NONE
    told &= here[..., None]
    seen = here[key]
    with_gaps = 0
    for person in range(seen.shape[1]):
        steps = np.diff(np.flatnonzero(seen[:, person]))
        with_gaps += bool((steps > 1).any())
    return Written(
        name=world.name,
        frames=world.frames,
        people=int(here.any(axis=0).sum()),
        images=images,
        boxes=int(here.sum()),
        occluded=int((here & (occlusion(world) >= 2)).sum()),
        labels=int(told[key].sum()),
        hard_labels=int((told & (level == HARD))[key].sum()),
        tracks=int(seen.any(axis=0).sum()),
        tracks_with_gaps=with_gaps,
        solid=int(world.present.sum()),
        without_points=int((world.present & (lidar_points(world, quirks) == 0)).sum()),
        interactions=interactions,
    )


def rows(written: Sequence[Written]) -> list[dict[str, Any]]:
    """One row per share: what, here, in JRDB (the test split; hard labels also its train split, interactions that
    alone)."""

    def share(part: int, whole: int) -> str:
        return f"{100 * part / whole:.1f} %" if whole else "n/a"

    def total(field: str) -> int:
        return sum(getattr(one, field) for one in written)

    frames = total("frames")
    return [
        {
            "what": "boxes severely or fully occluded",
            "here": share(total("occluded"), total("boxes")),
            "JRDB": "56 %",
        },
        {
            "what": "action labels of difficulty 3",
            "here": share(total("hard_labels"), total("labels")),
            "JRDB": "26-42 %",
        },
        {
            "what": "people with a gap at keyframes",
            "here": share(total("tracks_with_gaps"), total("tracks")),
            "JRDB": "30 %",
        },
        {
            "what": "people per frame",
            "here": f"{total('boxes') / frames:.1f}" if frames else "n/a",
            "JRDB": "34",
        },
        {
            "what": "3D boxes without lidar points",
            "here": share(total("without_points"), total("solid")),
            "JRDB": "3 %",
        },
        {
            "what": "interactions per person and frame",
            "here": f"{total('interactions') / total('boxes'):.2f}" if total("boxes") else "n/a",
            "JRDB": "1.7",
        },
    ]
