"""The panoptic layer: `labels_2d_panoptic_stitched_CW/<sequence>.json` -> the tables `panoptic` and `categories`.

Masks of things and of their surroundings, once per second. A thing is known by its track and its category together:
tracks restart in each category. Category numbers belong to the file, so its list of names is stored too. People are
annotated here as well; they stay in the table, but only the box layers count people.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.coco import (
    Images,
    Index,
    Number,
    categories_table,
    open_coco,
    read_categories,
    read_chunks,
)
from jrdb_avr.loaders.labelfiles.columns import LayerTables, Refusals, ascending, known_frames, mask_of, nullable
from jrdb_avr.loaders.labelfiles.frames import RecordReader
from jrdb_avr.loaders.labelfiles.records import ABSENT, BROKEN, NOTHING
from jrdb_avr.loaders.layers.boxes_2d import StitchedBox, usable_boxes
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Ints

MAX_SEGMENTATION: Final = 1 << 20
"""Maximum bytes of a stored mask. A mask of every second pixel of the panorama takes about as much."""
NO_TRACK: Final = -1

_NO_BOX: Final = (math.nan,) * 4

Track = int | float | str | None


class Attributes(msgspec.Struct, gc=False):
    """The `attributes` object. Some files have the track here."""

    tracking_id: Track = None
    floor_id: Track = None


class SegmentAnnotation(msgspec.Struct, gc=False):
    """One thing, or a whole kind of surroundings, in one image."""

    image_id: Number
    category_id: Index
    tracking_id: Track = None
    attributes: Attributes | None = None
    bbox: StitchedBox | None = None
    area: float | None = None
    segmentation: msgspec.Raw = NOTHING
    id: msgspec.Raw = NOTHING


class RunLengths(msgspec.Struct, gc=False):
    """A mask as run lengths, column by column: numbers, or packed into text."""

    size: tuple[int, int]
    counts: str | list[int]


_READER: Final = RecordReader(SegmentAnnotation)
_SEGMENTATION: Final = msgspec.json.Decoder(RunLengths | list[list[float]])


def load_panoptic(path: Path, problems: Problems) -> LayerTables:
    """Read a panoptic file.

    Raises:
        InputError: the file as a whole cannot be used.
    """
    file = open_coco(path)
    images = Images(file, path.stem, problems)
    categories, unknown = read_categories(file, problems)
    parts: dict[str, list[Any]] = defaultdict(list)
    for chunk in read_chunks(file.annotations, "annotation", _READER, problems):
        for name, column in _take(chunk, images.frames_of(chunk, problems), problems).items():
            parts[name].append(column)
    texts = pa.concat_arrays(parts.pop("segmentation"))
    columns = {name: np.concatenate(parts.pop(name)) for name in list(parts)}
    frame, track, category = (columns[name] for name in ("frame", "object", "category_id"))
    refusals = Refusals(frame, problems)
    # By frame, category and track. Things without a track come last, in the order of the file.
    rows = ascending(frame, category, track == NO_TRACK, track)
    same = np.zeros(len(rows), np.bool_)
    same[1:] = track[rows[1:]] != NO_TRACK
    for column in (frame, category, track):
        same[1:] &= column[rows[1:]] == column[rows[:-1]]
    again = mask_of(rows[same], len(track))
    refusals.count(again, "record", "same thing twice in a frame, the first is kept", "tracking_id", _item(track))
    wrong = ~np.isin(category, list(categories))
    refusals.count(wrong, "field", "not in the list of categories", "category_id", _item(category))
    rows = rows[~same]
    columns["box"][~usable_boxes(columns["box"], refusals, "bbox")] = np.nan
    area = columns["area"]
    odd = ~np.isnan(area) & ~((area >= 0) & (area <= records.MAX_PIXEL**2))
    refusals.count(odd, "field", "number out of range", "area", lambda row: float(area[row]))
    area[odd] = np.nan
    table = pa.table(
        {
            "frame": frame[rows],
            "object": nullable(track[rows], track[rows] == NO_TRACK, pa.int32()),
            "category_id": category[rows],
            **{name: _number_column(columns["box"][rows, i]) for i, name in enumerate("xywh")},
            "area": _number_column(area[rows]),
            "segmentation": texts.take(pa.array(rows)),
        }
    )
    frames = known_frames(np.sort(images.frame), frame[rows])
    return LayerTables({"panoptic": table, "categories": categories_table(categories)}, {"panoptic": frames}, unknown)


def _number_column(values: npt.NDArray[Any]) -> pa.Array:
    return nullable(values, np.isnan(values), pa.float64())


def _item(values: Any) -> Callable[[int], object]:
    """Return a function that returns the value of a row, for the report."""
    return lambda row: int(values[row])


# -- columns of a chunk --------------------------------------------------------------------------------------------


def _take(chunk: list[SegmentAnnotation], frame: Ints, problems: Problems) -> dict[str, Any]:
    """Return the columns of the annotations with a frame. A missing number is NaN."""
    rows = np.flatnonzero(frame >= 0)
    chunk = [chunk[row] for row in rows.tolist()]
    refusals = Refusals(frame[rows], problems)
    return {
        "frame": frame[rows],
        "category_id": np.fromiter(map(attrgetter("category_id"), chunk), np.int64, len(chunk)),
        "object": np.array([_track(row, annotation, refusals) for row, annotation in enumerate(chunk)], np.int64),
        "box": np.array([annotation.bbox or _NO_BOX for annotation in chunk], np.float64).reshape(-1, 4),
        "area": np.array([annotation.area for annotation in chunk], np.float64),
        "segmentation": _segmentations(chunk, refusals),
    }


def _track(row: int, annotation: SegmentAnnotation, refusals: Refusals) -> int:
    """Return the first track under the three names, or NO_TRACK for a missing or unusable track."""
    inner = annotation.attributes or Attributes()
    values = (annotation.tracking_id, inner.tracking_id, inner.floor_id)
    value = next((value for value in values if value is not None), NO_TRACK)
    try:
        return records.read_whole(value, NO_TRACK, records.MAX_TRACK)
    except ValueError as error:
        refusals.add("field", f"track: {error}", "tracking_id", row, value, 1)
        return NO_TRACK


def _segmentations(chunk: Sequence[SegmentAnnotation], refusals: Refusals) -> pa.Array:
    """Return the masks as text without blanks. A missing or unusable mask is null."""
    texts: list[bytes | None] = []
    for row, annotation in enumerate(chunk):
        raw = bytes(annotation.segmentation)
        try:
            texts.append(None if raw in ABSENT else _compact(raw))
        except ValueError as error:
            refusals.add("field", f"segmentation: {error}", "segmentation", row, raw[:100], 1)
            texts.append(None)
    return pa.array(texts, pa.binary()).cast(pa.string())


def _compact(raw: bytes) -> bytes:
    """Return a mask without blanks. Raise ValueError if it is neither run lengths nor polygons."""
    if len(raw) > MAX_SEGMENTATION:
        raise ValueError(f"larger than {MAX_SEGMENTATION >> 20} MB")
    try:
        mask = _SEGMENTATION.decode(raw)
    except BROKEN:
        raise ValueError("neither run lengths nor polygons") from None
    if isinstance(mask, list) and any(len(polygon) < 6 or len(polygon) % 2 for polygon in mask):
        raise ValueError("a polygon is not three or more pairs of numbers")
    return msgspec.json.format(raw, indent=-1)
