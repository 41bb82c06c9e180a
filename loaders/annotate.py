"""One sequence's files -> its annotation tables: every layer is read by its own loader, then brought together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS, LAYERS

from .boxes2d import load_2d
from .boxes3d import heading_check, load_3d
from .columns import constant
from .layers import SequenceFiles, image_frames
from .panoptic import load_panoptic
from .pose import load_pose
from .problems import Problem, Problems
from .reading import Reading
from .report import Heading, UnknownLabel

Ints = npt.NDArray[np.int64]

READERS: Final[dict[str, Callable[[Path, str, Problems], Reading]]] = {
    "2d": load_2d,
    "3d": load_3d,
    "pose": load_pose,
    "panoptic": load_panoptic,
}
"""Loader of each file, in the order in which they are read."""


@dataclass(frozen=True)
class Annotated:
    """All annotation tables of a sequence, and what is to be reported of it."""

    tables: dict[str, pa.Table]
    """Every table of `ANNOTATIONS`; empty where nothing could be read."""
    frames: dict[str, tuple[Ints, Ints]]
    """Per layer found: its frames and the records in each; empty where no label file could be used."""
    unknown: list[UnknownLabel]
    problems: list[Problem]
    heading: Heading | None


def annotate(files: SequenceFiles) -> Annotated:
    """Read every file of a sequence. A file that cannot be used as a whole is a problem, never an error."""
    sequence = files.sequence
    tables: dict[str, pa.Table] = {}
    frames: dict[str, tuple[Ints, Ints]] = {}
    unknown: Counter[tuple[str, str]] = Counter()
    problems: list[Problems] = []
    for layer, read in READERS.items():
        if layer not in files.labels:
            continue
        path = Path(files.labels[layer])
        problems.append(Problems(path.name))
        try:
            reading = read(path, sequence, problems[-1])
        except InputError as error:
            problems[-1].add("file", str(error))
            continue
        tables |= reading.tables
        frames |= reading.frames
        unknown += reading.unknown
    if any(len(known) for known, _ in frames.values()):
        pictures: list[int] = []
        try:
            pictures = image_frames(files.images)
        except InputError as error:
            problems.append(Problems(error.file))
            problems[-1].add("file", str(error))
        frames["images"] = np.array(pictures, np.int64), np.ones(len(pictures), np.int64)
    else:
        frames = {}
    heading = heading_check(tables["boxes_3d"]) if "boxes_3d" in tables else None
    tables["frames"] = _frames_table(sequence, frames)
    return Annotated(
        {layer: tables.get(layer, schema.empty_table()) for layer, schema in ANNOTATIONS.items()},
        frames,
        [UnknownLabel(*key, count) for key, count in sorted(unknown.items())],
        [problem for layer in problems for problem in layer.listed()],
        heading,
    )


def _frames_table(sequence: str, frames: dict[str, tuple[Ints, Ints]]) -> pa.Table:
    parts = [
        pa.table(
            {
                "sequence": constant(sequence, len(frames[layer][0])),
                "layer": constant(layer, len(frames[layer][0])),
                "frame": frames[layer][0],
                "records": frames[layer][1],
            }
        ).cast(ANNOTATIONS["frames"])
        for layer in LAYERS
        if layer in frames
    ]
    return pa.concat_tables(parts) if parts else ANNOTATIONS["frames"].empty_table()
