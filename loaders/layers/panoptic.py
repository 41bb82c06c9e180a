"""Loader of the panoptic layer, from `labels_2d_panoptic_stitched_CW/<sequence>.json`.

The loader makes the tables `panoptic` and `categories`. The files have masks of things and of background areas for one
frame per second. The numbers of tracks start again in each category, so a thing is identified by its track and its
category together. Category ids have a meaning only inside one file, so the names of the categories are stored too. The
files also annotate people. The rows of people are kept in the table, but people are counted from the box layers only.
"""

from __future__ import annotations

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
    ImageId,
    Images,
    ShortId,
    categories_table,
    open_coco,
    read_categories,
    read_chunks,
)
from jrdb_avr.loaders.labelfiles.columns import LayerTables, Refusals, first_of_equal, known_frames, mask_of, nullable
from jrdb_avr.loaders.labelfiles.frames import RecordReader
from jrdb_avr.loaders.labelfiles.records import ABSENT, BROKEN, NOTHING
from jrdb_avr.loaders.layers.boxes_2d import NO_BOX, StitchedBox, usable_boxes
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Ints

MAX_SEGMENTATION: Final = 1 << 20
"""Maximum bytes of a mask. A mask that contains every second pixel of the panorama has about this size."""
NO_TRACK: Final = -1
"""Track of a record without a usable track. Some files write this value for a missing track."""

Track = int | float | str | None
"""Track as written in a file."""


class Attributes(msgspec.Struct, gc=False):
    """The object `attributes` of a record. In some files the track is a member of this object."""

    tracking_id: Track = None
    floor_id: Track = None


class SegmentAnnotation(msgspec.Struct, gc=False):
    """Record of one segment in one image.

    The segment is either one thing or the whole area of one background category, for example the floor.
    """

    image_id: ImageId
    category_id: ShortId
    tracking_id: Track = None
    attributes: Attributes | None = None
    bbox: StitchedBox | None = None
    area: float | None = None
    segmentation: msgspec.Raw = NOTHING
    id: msgspec.Raw = NOTHING


class RunLengths(msgspec.Struct, gc=False):
    """Mask in COCO's run-length format, which goes column by column. `counts` is a list or COCO's packed string."""

    size: tuple[int, int]
    counts: str | list[int]


_READER: Final = RecordReader(SegmentAnnotation)
_SEGMENTATION: Final = msgspec.json.Decoder(RunLengths | list[list[float]])


def load_panoptic(path: Path, problems: Problems) -> LayerTables:
    """Read a panoptic file.

    Args:
        path: label file.
        problems: counter of refused parts.

    Returns:
        The tables `panoptic` and `categories`, and the frames of the layer `panoptic`.

    Raises:
        InputError: If the file as a whole cannot be used.
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
    # Records of the same thing must be neighbours, so rows are sorted by frame, category and track.
    rows, first = first_of_equal(frame, category, track == NO_TRACK, track)
    same = ~first & (track[rows] != NO_TRACK)
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
    frames = known_frames(images.frame, frame[rows])
    return LayerTables({"panoptic": table, "categories": categories_table(categories)}, {"panoptic": frames}, unknown)


def _number_column(values: npt.NDArray[Any]) -> pa.Array:
    return nullable(values, np.isnan(values), pa.float64())


def _item(values: Any) -> Callable[[int], object]:
    """Return a function that takes a row index and returns the number at this index of `values`, as an int."""
    return lambda row: int(values[row])


# -- columns of a chunk --------------------------------------------------------------------------------------------


def _take(chunk: list[SegmentAnnotation], frame: Ints, problems: Problems) -> dict[str, Any]:
    """Return the columns of a chunk of annotations. Annotations without a frame are left out.

    The argument `frame` has the frame of each annotation, or -1. A missing number of a box or area becomes NaN.
    """
    rows = np.flatnonzero(frame >= 0)
    chunk = [chunk[row] for row in rows.tolist()]
    refusals = Refusals(frame[rows], problems)
    return {
        "frame": frame[rows],
        "category_id": np.fromiter(map(attrgetter("category_id"), chunk), np.int64, len(chunk)),
        "object": np.array([_track(row, annotation, refusals) for row, annotation in enumerate(chunk)], np.int64),
        "box": np.array([annotation.bbox or NO_BOX for annotation in chunk], np.float64).reshape(-1, 4),
        "area": np.array([annotation.area for annotation in chunk], np.float64),
        "segmentation": _segmentations(chunk, refusals),
    }


def _track(row: int, annotation: SegmentAnnotation, refusals: Refusals) -> int:
    """Return the track of an annotation, or NO_TRACK if the annotation has no usable track.

    Three fields may hold the track. Only the first of them that has a value is read.
    """
    inner = annotation.attributes or Attributes()
    values = (annotation.tracking_id, inner.tracking_id, inner.floor_id)
    value = next((value for value in values if value is not None), NO_TRACK)
    try:
        return records.read_whole(value, NO_TRACK, records.MAX_TRACK)
    except ValueError as error:
        refusals.add("field", f"track: {error}", "tracking_id", row, value, 1)
        return NO_TRACK


def _segmentations(chunk: Sequence[SegmentAnnotation], refusals: Refusals) -> pa.Array:
    """Return the masks as JSON strings without blanks. A missing or unusable mask is null."""
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
    """Return the JSON of a mask without blanks.

    Raise ValueError if the mask is too large, or is neither run lengths nor polygons.
    """
    if len(raw) > MAX_SEGMENTATION:
        raise ValueError(f"larger than {MAX_SEGMENTATION >> 20} MB")
    try:
        mask = _SEGMENTATION.decode(raw)
    except BROKEN:
        raise ValueError("neither run lengths nor polygons") from None
    if isinstance(mask, list) and any(len(polygon) < 6 or len(polygon) % 2 for polygon in mask):
        raise ValueError("a polygon is not three or more pairs of numbers")
    return msgspec.json.format(raw, indent=-1)
