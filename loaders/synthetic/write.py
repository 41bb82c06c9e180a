"""Writes a sample root, one sequence at a time, each from its own seed, in worker processes; and sums up its shares."""

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
_CALIBRATION: Final = Path(__file__).parent / "calibration"
"""Files laid out like the published ones; the numbers are the sample's own."""

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
"""What, the count above and below the line, how it is printed, and its value in JRDB (the test split; hard labels also
its train split, interactions that alone)."""


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
    """Counts of a sequence, for the summary. Shares are counted over 2D boxes (hard labels: over labels at keyframes;
    gaps: over people, at keyframes; points: over people in view)."""

    name: str
    boxes: int
    images: int
    counts: Counter[str]


def sequence_name(index: int) -> str:
    """The name of the sample's sequence number `index`, from 0."""
    return f"sample-{_PLACES[index % len(_PLACES)]}-{index // len(_PLACES) + 1:02d}_{index % 4}"


def plan(root: Path, sizes: list[tuple[int, int]], seed: int, images: str) -> list[Order]:
    """Orders for sequences of these (frames, people), written into `root`; `images` as in `render.image_frames`."""
    return [
        Order(str(root), sequence_name(i), seed, frames, people, images) for i, (frames, people) in enumerate(sizes)
    ]


def write(orders: list[Order], workers: int) -> Iterator[Written]:
    """Write the sequences; yields each as it is done, in no fixed order."""
    for root in {order.root for order in orders}:
        shutil.copytree(_CALIBRATION, Path(root) / "calibration")
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
    return Written(order.name, counts["boxes"], len(images), counts)


def _count(world: World, quirks: Quirks) -> Counter[str]:
    key = np.arange(KEYFRAME_STEP, world.frames, KEYFRAME_STEP)
    level, _ = drawn_difficulty(world)
    # A pose, and up to two other actions.
    labels = np.insert(world.actions != NONE, 0, True, axis=2)[key] & world.boxed[key][..., None]
    seen = world.boxed[key]
    return Counter(
        {
            "frames": world.frames,
            "boxes": int(world.boxed.sum()),
            "occluded": int((world.boxed & world.hidden).sum()),
            "labels": int(labels.sum()),
            "hard labels": int((labels & (level[key] == HARD_CODE)).sum()),
            "tracks": int(seen.any(axis=0).sum()),
            "tracks with gaps": sum(bool((np.diff(np.flatnonzero(person)) > 1).any()) for person in seen.T),
            "solid": int(world.present.sum()),
            "without points": int((world.present & (lidar_points(world, quirks) == 0)).sum()),
        }
    )


def rows(written: Sequence[Written]) -> list[dict[str, Any]]:
    """One row per share: what, here, in JRDB."""
    total = sum((one.counts for one in written), Counter())
    out = []
    for what, part, whole, form, published in _SHARES:
        here = form.format(total[part] / total[whole]).replace("%", " %") if total[whole] else "n/a"
        out.append({"what": what, "here": here, "JRDB": published})
    return out
