"""Writes a sample root: one sequence at a time, each from its own seed, in worker processes.

A layer is a function of the simulated world; a further one is another entry in `_LAYERS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from jrdb_avr.loaders.shards import map_shards
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.rules import KEYFRAME_STEP

from .labels import HARD, annotated, difficulty, labels_2d, labels_3d, occlusion
from .render import image_frames, write_images
from .script import NONE
from .world import World, build

_PLACES: Final = ("plaza", "cafe", "hall", "library", "street", "lobby", "atrium", "campus", "market")

_LAYERS: Final[dict[str, Callable[[World], dict[str, Any]]]] = {
    "labels/labels_2d_stitched": labels_2d,
    "labels/labels_3d": labels_3d,
}
"""Folder of each layer of one JSON file per sequence, and what makes its content."""

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
    keyframes; gaps: over people, at keyframes)."""

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
    for _, written in map_shards(write_sequence, orders, workers, lambda order: order.frames * order.people):
        yield written


def write_sequence(order: Order) -> Written:
    """Simulate one sequence and write its files."""
    world = build(order.name, order.seed, order.frames, order.people)
    root = Path(order.root)
    for folder, layer in _LAYERS.items():
        path = root / folder / f"{order.name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(msgspec.json.encode(layer(world)))
    images = image_frames(world, order.images)
    if images:
        write_images(world, images, root / "images" / "image_stitched" / order.name)
    return _count(world, len(images))


def _count(world: World, images: int) -> Written:
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
    )
