"""The panoptic layer: `labels_2d_panoptic_stitched_CW/<sequence>.json` -> the tables `panoptic` and `categories`.

Masks of things and of their surroundings, once per second. A thing is known by its track and its category together:
tracks restart in each category. Category numbers are the file's own, so each file's list of names is stored beside.
People are annotated here too; they stay in the table, but it is the box layers that count them.
"""

from __future__ import annotations

import functools
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
    MAX_CATEGORY,
    NUMBER,
    Images,
    Number,
    annotation_frames,
    annotation_reader,
    categories_table,
    crowded,
    open_coco,
    read_categories,
    read_list,
)
from jrdb_avr.loaders.labelfiles.columns import LayerTables, Refusals, ascending, known_frames, mask_of, nullable
from jrdb_avr.loaders.labelfiles.json import ABSENT, BROKEN, NOTHING, first_members, parse
from jrdb_avr.loaders.labelfiles.record_reader import Fields
from jrdb_avr.loaders.labelfiles.records import Rule, optional
from jrdb_avr.loaders.layers.boxes_2d import usable_boxes
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.arrays import Ints

MAX_SEGMENTATION: Final = 1 << 20
"""The most bytes of a mask that is stored; a mask of every second pixel of the panorama takes about as much."""
NO_TRACK: Final = -1

_NO_BOX: Final = (math.nan,) * 4
# Names of tracks repeat from frame to frame.
_parse: Final = functools.lru_cache(maxsize=10_000)(parse)


class SegmentAnnotation(msgspec.Struct, gc=False):
    """One thing, or all there is of a stuff, in one image. Some files have the track in `attributes`."""

    image_id: Number
    category_id: Number
    tracking_id: msgspec.Raw = NOTHING
    attributes: msgspec.Raw = NOTHING
    bbox: tuple[float, float, float, float] | None = None
    area: float | None = None
    segmentation: msgspec.Raw = NOTHING
    id: msgspec.Raw = NOTHING


class RunLengths(msgspec.Struct, gc=False):
    """A mask as run lengths: column by column, as numbers or packed into a text."""

    size: tuple[int, int]
    counts: str | list[int]


_SEGMENTATION: Final = msgspec.json.Decoder(RunLengths | list[list[float]])


def _track_keys(fields: Fields) -> list[tuple[int, tuple[bytes, ...]]]:
    """How often the names of the track are written, attributes included."""
    outer = {b'"tracking_id"': len([raw for raw in fields["tracking_id"] if raw is not NOTHING]), b'"floor_id"': 0}
    attributes = [bytes(raw) for raw in fields["attributes"] if raw is not NOTHING]
    return [(count + sum(raw.count(key) for raw in attributes), (key,)) for key, count in outer.items()]


_READER: Final = annotation_reader(
    SegmentAnnotation,
    {
        "image_id": NUMBER,
        "category_id": NUMBER,
        "bbox": Rule(optional(records.box), reason="bbox: "),
        "area": Rule(optional(records.number)),
    },
    ("image_id", "category_id", "bbox"),
    _track_keys,
)


def load_panoptic(path: Path, problems: Problems) -> LayerTables:
    """Read a panoptic file. Raises InputError if the file as a whole cannot be used."""
    file = open_coco(path, problems)
    images = Images(file, problems)
    categories, unknown = read_categories(file, problems)
    parts: dict[str, list[Any]] = defaultdict(list)
    for chunk in read_list(file, "annotations", _READER, problems):
        for name, column in _take(chunk, annotation_frames(chunk, images, problems), problems).items():
            parts[name].append(column)
    texts = pa.concat_arrays(parts.pop("segmentation"))
    columns = {name: np.concatenate(parts.pop(name)) for name in list(parts)}
    frame, track, category = (columns[name] for name in ("frame", "object", "category_id"))
    refusals = Refusals(frame, problems)
    full = crowded(frame, refusals)
    # By frame, category and track, those without a track last and in the file's order.
    rows = np.flatnonzero(~full)
    rows = rows[ascending(frame[rows], category[rows], track[rows] == NO_TRACK, track[rows])]
    same = np.zeros(len(rows), np.bool_)
    same[1:] = track[rows[1:]] != NO_TRACK
    for column in (frame, category, track):
        same[1:] &= column[rows[1:]] == column[rows[:-1]]
    again = mask_of(rows[same], len(track))
    refusals.count(again, "record", "same thing twice in a frame, the first is kept", "tracking_id", _item(track))
    wrong = ~np.isin(category, list(categories)) & ~full
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
    known = known_frames(np.setdiff1d(images.frame, frame[full]), frame[rows])
    return LayerTables({"panoptic": table, "categories": categories_table(categories)}, {"panoptic": known}, unknown)


def _number_column(values: npt.NDArray[Any]) -> pa.Array:
    return nullable(values, np.isnan(values), pa.float64())


def _item(values: Any) -> Callable[[int], object]:
    """The value of a row, for the report."""
    return lambda row: int(values[row])


# -- columns of a chunk --------------------------------------------------------------------------------------------


def _take(chunk: list[SegmentAnnotation], frame: Ints, problems: Problems) -> dict[str, Any]:
    """Columns of the annotations of a chunk that have a frame and a category; numbers are NaN where there is none."""
    category = np.fromiter(map(attrgetter("category_id"), chunk), np.int64, len(chunk))
    odd = (category < 0) | (category > MAX_CATEGORY)
    Refusals(frame, problems).count((frame >= 0) & odd, "record", "number out of range", "category_id", _item(category))
    rows = np.flatnonzero((frame >= 0) & ~odd)
    chunk = [chunk[row] for row in rows.tolist()]
    refusals = Refusals(frame[rows], problems)
    return {
        "frame": frame[rows],
        "category_id": category[rows],
        "object": np.array([_track(row, annotation, refusals) for row, annotation in enumerate(chunk)], np.int64),
        # Numbers of a file are finite by now.
        "box": np.array([annotation.bbox or _NO_BOX for annotation in chunk], np.float64).reshape(-1, 4),
        "area": np.array([annotation.area for annotation in chunk], np.float64),
        "segmentation": _segmentations(chunk, refusals),
    }


def _track(row: int, annotation: SegmentAnnotation, refusals: Refusals) -> int:
    """The first of the three names of the track that has a value; NO_TRACK where there is none or it is unusable."""
    inner: dict[str, Any] = {}
    raw = bytes(annotation.attributes)
    try:
        if raw not in ABSENT:
            inner, again = first_members(_parse(raw))
            for key in again:
                refusals.add("field", records.TWICE, f"attributes.{shorten(key)}", row, raw, 1)
    except ValueError as error:
        refusals.add("field", str(error), "attributes", row, raw, 1)
    raw = bytes(annotation.tracking_id)
    try:
        outer = None if raw in ABSENT else _parse(raw)
        values = (outer, inner.get("tracking_id"), inner.get("floor_id"))
        value = next((value for value in values if value is not None), NO_TRACK)
        return records.whole(value, NO_TRACK, records.MAX_TRACK)
    except ValueError as error:
        refusals.add("field", f"track: {error}", "tracking_id", row, raw, 1)
        return NO_TRACK


def _segmentations(chunk: Sequence[SegmentAnnotation], refusals: Refusals) -> pa.Array:
    """Masks as text without blanks, null where there is none."""
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
    """A mask without blanks. Raises ValueError where it is neither run lengths nor polygons."""
    if len(raw) > MAX_SEGMENTATION:
        raise ValueError(f"larger than {MAX_SEGMENTATION >> 20} MB")
    try:
        mask = _SEGMENTATION.decode(raw)
    except BROKEN:
        raise ValueError("neither run lengths nor polygons") from None
    if isinstance(mask, list) and any(len(polygon) < 6 or len(polygon) % 2 for polygon in mask):
        raise ValueError("a polygon is not three or more pairs of numbers")
    return msgspec.json.format(raw, indent=-1)
