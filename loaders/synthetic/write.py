"""Write a sample root in worker processes, each sequence from its own seed, and sum up its shares."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from jrdb_avr.loaders.synthetic.box_files import HARD_CODE, Quirks, drawn_difficulty, lidar_points
from jrdb_avr.loaders.synthetic.label_files import label_texts
from jrdb_avr.loaders.synthetic.pictures import panorama_frames, write_images
from jrdb_avr.loaders.synthetic.script import NONE
from jrdb_avr.loaders.synthetic.social_files import SocialFiles
from jrdb_avr.loaders.synthetic.world import World
from jrdb_avr.queries.workers import map_sequences
from jrdb_avr.schema.rules import KEYFRAME_STEP

_PLACES: Final = ("plaza", "cafe", "hall", "library", "street", "lobby", "atrium", "campus", "market")
CALIBRATION_FILES: Final = Path(__file__).parent / "calibration"
"""Calibration files in the layout of the published ones. The numbers are the sample's."""

FULL_SCALE: Final = (
    *((1079, 12), (715, 11), (789, 13), (1604, 42), (1222, 23), (638, 18), (1663, 7), (425, 5), (791, 23)),
    *((787, 7), (569, 11), (1659, 15), (1668, 43), (1177, 9), (1006, 20), (1227, 29), (503, 18), (498, 21)),
    *((1651, 27), (434, 7), (1399, 13), (498, 13), (475, 8), (642, 30), (1222, 107), (1661, 125), (1659, 75)),
)
"""Frames and people in view of 27 sequences, as uneven as those of the JRDB test split."""


_SHARES: Final = (
    ("boxes severely or fully occluded", "occluded", "boxes", "{:.1%}", "56 %"),
    ("action labels of difficulty 3", "hard labels", "labels", "{:.1%}", "26-42 %"),
    ("people with a gap at keyframes", "tracks with gaps", "tracks", "{:.1%}", "30 %"),
    ("people per frame", "boxes", "frames", "{:.1f}", "34"),
    ("3D boxes without lidar points", "without points", "solid", "{:.1%}", "3 %"),
    ("interactions per person and frame", "interactions", "boxes", "{:.2f}", "1.7"),
)
"""Share, the counts above and below the line, the format, and its value in JRDB.

Values are of the test split. Hard labels are of both splits, interactions of the train split.
"""


@dataclass(frozen=True)
class Order:
    """Sequence to write."""

    root: str
    name: str
    seed: int
    frames: int
    people: int
    images: str


@dataclass(frozen=True)
class Written:
    """Counts of a sequence for the summary.

    Shares are counted over 2D boxes. Hard labels are counted over labels at keyframes, gaps over people at keyframes,
    and points over people in view.
    """

    name: str
    images: int
    counts: Counter[str]


def sequence_name(index: int) -> str:
    """Return the name of the sample's sequence number `index`, from 0."""
    return f"sample-{_PLACES[index % len(_PLACES)]}-{index // len(_PLACES) + 1:02d}_{index % 4}"


def plan(root: Path, sizes: list[tuple[int, int]], seed: int, images: str) -> list[Order]:
    """Return orders for sequences of (frames, people) in `root`. `images` is as in `pictures.panorama_frames`."""
    return [
        Order(str(root), sequence_name(i), seed, frames, people, images) for i, (frames, people) in enumerate(sizes)
    ]


def write(orders: list[Order], workers: int) -> Iterator[Written]:
    """Write the sequences. Yield each when it is done, in any order."""
    for root in {order.root for order in orders}:
        shutil.copytree(CALIBRATION_FILES, Path(root) / "calibration")
    for _, written in map_sequences(write_sequence, orders, workers, lambda order: order.frames * order.people):
        yield written


def write_sequence(order: Order) -> Written:
    """Simulate one sequence and write its files."""
    world = World(order.name, order.seed, order.frames, order.people)
    quirks, social = Quirks(world), SocialFiles(world)
    root = Path(order.root)
    with ExitStack() as stack:
        files: dict[str, BinaryIO] = {}
        for name, part in label_texts(world, quirks, social):
            if name not in files:
                path = root / name.format(order.name)
                path.parent.mkdir(parents=True, exist_ok=True)
                files[name] = stack.enter_context(path.open("wb"))
            files[name].write(part)
    images = panorama_frames(world, order.images)
    if images:
        write_images(world, images, root / "images" / "image_stitched" / order.name)
    counts = _count(world, quirks) + Counter({"interactions": social.interactions})
    return Written(order.name, len(images), counts)


def _count(world: World, quirks: Quirks) -> Counter[str]:
    key = np.arange(KEYFRAME_STEP, world.frames, KEYFRAME_STEP)
    level, _ = drawn_difficulty(world)
    # A pose, and up to two other actions.
    labels = np.insert(world.actions != NONE, 0, True, axis=2)[key] & world.boxed[key][..., None]
    counted = world.boxed[key]
    return Counter(
        {
            "frames": world.frames,
            "boxes": int(world.boxed.sum()),
            "occluded": int((world.boxed & world.hidden).sum()),
            "labels": int(labels.sum()),
            "hard labels": int((labels & (level[key] == HARD_CODE)).sum()),
            "tracks": int(counted.any(axis=0).sum()),
            "tracks with gaps": sum(bool((np.diff(np.flatnonzero(person)) > 1).any()) for person in counted.T),
            "solid": int(world.present.sum()),
            "without points": int((world.present & (lidar_points(world, quirks) == 0)).sum()),
        }
    )


def rows(written: Sequence[Written]) -> list[dict[str, Any]]:
    """Return one row per share: its name, its value in the sample, and its value in JRDB."""
    total = sum((item.counts for item in written), Counter())
    out = []
    for what, part, whole, form, published in _SHARES:
        value = form.format(total[part] / total[whole]).replace("%", " %") if total[whole] else "n/a"
        out.append({"what": what, "here": value, "JRDB": published})
    return out
