"""Conversion of all files of one sequence into its annotation tables.

Each layer has its own loader. If a comparison of boxes shows that a layer numbers its frames differently from the 2D
layer, the layer is refused. Social facts are read from the reasoning file only if the social file gives none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.loaders.labelfiles.columns import LayerTables, annotation_table, constant
from jrdb_avr.loaders.layers.boxes_2d import load_2d
from jrdb_avr.loaders.layers.boxes_3d import heading_check, load_3d
from jrdb_avr.loaders.layers.calibration import load_calibration
from jrdb_avr.loaders.layers.frame_offset import Tracks, check_shift, tracks_of
from jrdb_avr.loaders.layers.panoptic import load_panoptic
from jrdb_avr.loaders.layers.pose import load_pose
from jrdb_avr.loaders.layers.social import load_reasoning, load_social
from jrdb_avr.loaders.layers.timestamps import frame_rate, load_timestamps
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.loaders.report import ShiftCheck, Stamps, UnknownLabel
from jrdb_avr.loaders.root import LAYER_FILES, SequenceFiles, image_frames
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import ANNOTATIONS, LAYERS

READERS: Final[dict[str, Callable[[Path, Problems], LayerTables]]] = {
    "2d": load_2d,
    "3d": load_3d,
    "social": load_social,
    "pose": load_pose,
    "panoptic": load_panoptic,
    "timestamps": load_timestamps,
    "calibration": load_calibration,
}
"""Loader by layer. The reasoning layer is missing, because its loader also needs to know about the social file."""

SOCIAL_FACTS: Final = ("demographics", "interactions", "group_info")
"""Layers of the table `frames` that both social files and reasoning files can give."""
NOT_LABELS: Final = ("timestamps", "images")
"""Layers without labels. A frame that only these layers have is not annotated."""


class Annotated:
    """All annotation tables of a sequence, and the results of its checks for the load report.

    tables: dictionary from each name in `ANNOTATIONS` to the annotation table with this name.
    frames: dictionary from the name of a layer to two arrays: the layer's frames, and the number of records in each of
        these frames. The dictionary is empty if no label file was usable.
    """

    def __init__(
        self, files: SequenceFiles, readings: dict[str, LayerTables], problems: list[Problems], shifts: list[ShiftCheck]
    ) -> None:
        tables: dict[str, pa.Table] = {}
        frames: dict[str, tuple[Ints, Ints]] = {}
        unknown: Counter[tuple[str, str]] = Counter()
        for reading in readings.values():
            # Both the social and the reasoning file may give a table `listed`, so their rows are joined.
            both = [part["listed"] for part in (tables, reading.tables) if "listed" in part]
            tables |= reading.tables
            if both:
                tables["listed"] = pa.concat_tables(both)
            frames |= reading.frames
            unknown += reading.unknown
        if any(len(listed) for layer, (listed, _) in frames.items() if layer not in NOT_LABELS):
            pictures: list[int] = []
            try:
                pictures = image_frames(files.images)
            except InputError as error:
                problems.append(Problems(error.file, "images"))
                problems[-1].add("file", str(error))
            frames["images"] = np.array(pictures, np.int64), np.ones(len(pictures), np.int64)
        else:
            frames = {}
        self.heading = heading_check(tables["boxes_3d"]) if "boxes_3d" in tables else None
        tables["frames"] = _frames_table(files.sequence, frames)
        self.tables = {layer: tables.get(layer, schema.empty_table()) for layer, schema in ANNOTATIONS.items()}
        self.frames, self.shifts = frames, shifts
        self.unknown = [UnknownLabel(*key, count) for key, count in sorted(unknown.items())]
        self.problems = [problem for layer in _once(files, problems) for problem in layer.listed()]

    @property
    def label_frames(self) -> Ints:
        """Return the distinct frames of all layers of labels, ascending."""
        listed = [frames for layer, (frames, _) in self.frames.items() if layer not in NOT_LABELS]
        return np.unique(np.concatenate(listed)) if listed else np.empty(0, np.int64)


def stamps_of(table: pa.Table) -> Stamps | None:
    """Return a summary of an annotation table `timestamps`, or None if the table is empty."""
    images = table.filter(pc.equal(table["sensor"], "images"))
    rate = frame_rate(images["frame"].to_numpy(), images["timestamp"].to_numpy())
    return Stamps(len(images), len(table) - len(images), rate) if len(table) else None


def annotate(files: SequenceFiles) -> Annotated:
    """Read every file of a sequence. A file that cannot be used as a whole is counted as a problem and left out."""
    readings: dict[str, LayerTables] = {}
    problems: list[Problems] = []
    shifts: list[ShiftCheck] = []
    reference: Tracks | None = None
    for layer in LAYER_FILES:
        if layer not in files.labels:
            continue
        path = Path(files.labels[layer])
        problems.append(Problems(path.name, layer))
        try:
            reading = _read(layer, path, readings, problems[-1]).of(files.sequence)
        except InputError as error:
            # No record of the file is loaded, so the problems of its records are not reported.
            problems[-1] = Problems(path.name, layer)
            problems[-1].add("file", str(error))
            continue
        if layer == "2d":
            reference = tracks_of(layer, reading)
        check = None if files.labels.get("2d") == str(path) else _check(layer, reading, reference)
        if check is not None:
            shifts.append(check)
            if check.result == "shifted":
                problems[-1].add("file", check.reason, value=shorten(path.name))
                continue
        readings[layer] = reading
    return Annotated(files, readings, problems, shifts)


def _read(layer: str, path: Path, readings: dict[str, LayerTables], problems: Problems) -> LayerTables:
    """Read the file of a layer. `readings` maps each layer that has been read before to its tables."""
    if layer != "reasoning":
        return READERS[layer](path, problems)
    social = readings.get("social")
    served = social is not None and any(len(social.frames[fact][0]) for fact in SOCIAL_FACTS if fact in social.frames)
    return load_reasoning(path, problems, social=not served)


def _check(layer: str, reading: LayerTables, reference: Tracks | None) -> ShiftCheck | None:
    """Check whether a file numbers its frames like the 2D layer. Return None for a layer without boxes."""
    boxes = tracks_of(layer, reading)
    return None if boxes is None else check_shift(layer, boxes, reference)


def _once(files: SequenceFiles, problems: list[Problems]) -> list[Problems]:
    """Remove problems that are in two counters, and return all counters.

    If a file is read both for the 2D layer and for another layer, both counters hold the problems of the file. The
    problems then stay only in the counter of the 2D layer.
    """
    boxes = next((part for part in problems if part.layer == "2d"), None)
    for part in problems:
        if boxes is not None and part is not boxes and files.labels.get(part.layer) == files.labels["2d"]:
            part.without(boxes)
    return problems


def _frames_table(sequence: str, frames: dict[str, tuple[Ints, Ints]]) -> pa.Table:
    parts = [
        pa.table({"layer": constant(layer, len(listed)), "frame": listed, "records": records})
        for layer, (listed, records) in sorted(frames.items(), key=lambda item: LAYERS.index(item[0]))
    ]
    whole = pa.concat_tables(parts) if parts else ANNOTATIONS["frames"].remove(0).empty_table()
    return annotation_table("frames", sequence, whole)
