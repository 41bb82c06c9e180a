"""The panoptic layer: `labels_2d_panoptic_stitched_CW/<sequence>.json` -> the tables `panoptic` and `categories`.

Masks of things and of their surroundings, once per second. A thing is known by its track and its category together:
tracks restart in each category. Category numbers are the file's own, so that each file's list of names is kept beside.
People are annotated here too; they stay in the table, but it is the box layers that count them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import repeat
from operator import attrgetter, is_not
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records as fields
from jrdb_avr.loaders.labelfiles.coco import (
    MAX_CATEGORY,
    ListReader,
    Number,
    categories_table,
    crowded,
    known_images,
    open_coco,
    place_of,
    read_categories,
    read_images,
    repaired_number,
)
from jrdb_avr.loaders.labelfiles.columns import Refusals, constant, known_frames, mask_of, nullable
from jrdb_avr.loaders.labelfiles.keys import WrittenKeys
from jrdb_avr.loaders.labelfiles.records import record_parts, unpacked
from jrdb_avr.loaders.layers.layer import Reading
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Bools, Floats, Ints
from jrdb_avr.schema.tables import ANNOTATIONS

MAX_SEGMENTATION: Final = 1 << 20
"""The most bytes of a mask that is kept; a mask of every second pixel of the panorama takes about as much."""
NO_TRACK: Final = -1

Box = tuple[float, float, float, float]
_MaybeNumber = Number | None | msgspec.UnsetType
_NOTHING: Final = msgspec.Raw(b"")


class Attributes(msgspec.Struct, gc=False):
    """Where some files put the track."""

    tracking_id: _MaybeNumber = msgspec.UNSET
    floor_id: _MaybeNumber = msgspec.UNSET


class Annotation(msgspec.Struct, gc=False):
    """One thing, or all there is of a stuff, in one image."""

    image_id: Number
    category_id: Number
    tracking_id: _MaybeNumber = msgspec.UNSET
    attributes: Attributes | None = None
    bbox: Box | None = None
    area: float | None = None
    segmentation: msgspec.Raw = _NOTHING
    id: int | str | None = None

    @property
    def tracks(self) -> tuple[_MaybeNumber, ...]:
        """What stands under the names of the track."""
        inner = self.attributes
        return (self.tracking_id,) if inner is None else (self.tracking_id, inner.tracking_id, inner.floor_id)

    @property
    def track(self) -> int:
        """The first number under a name of the track, else NO_TRACK."""
        if isinstance(self.tracking_id, int):
            return self.tracking_id
        return next((number for number in self.tracks if isinstance(number, int)), NO_TRACK)


class RunLengths(msgspec.Struct, gc=False):
    """A mask as run lengths: column by column, as numbers or packed into a text."""

    size: tuple[int, int]
    counts: str | list[int]


_SEGMENTATION: Final = msgspec.json.Decoder(RunLengths | list[list[float]])


def load_panoptic(path: Path, sequence: str, problems: Problems) -> Reading:
    """Read a panoptic file. Raises InputError if the file as a whole cannot be used."""
    file = open_coco(path, problems)
    images = read_images(file, sequence, problems)
    categories, unknown = read_categories(file, problems)
    parts: list[dict[str, Any]] = []
    for chunk in _ANNOTATIONS.read(file, "annotations", problems):
        image = np.fromiter(map(attrgetter("image_id"), chunk), np.int64, len(chunk))
        frame = known_images(images, image, list(map(attrgetter("id"), chunk)).__getitem__, problems)
        refusals = Refusals(frame, "jpg", problems)
        category = np.fromiter(map(attrgetter("category_id"), chunk), np.int64, len(chunk))
        odd = (category < 0) | (category > MAX_CATEGORY)
        refusals.count((frame >= 0) & odd, "record", "number out of range", "category_id", _item(category))
        rows = np.flatnonzero((frame >= 0) & ~odd)
        kept = [chunk[row] for row in rows.tolist()]
        refusals = Refusals(frame[rows], "jpg", problems)
        parts.append(
            {
                "frame": frame[rows],
                "category_id": category[rows],
                "object": _tracks(kept, refusals),
                "box": _boxes(kept),
                "area": np.array(list(map(attrgetter("area"), kept)), np.float64),
                "segmentation": _segmentations(kept, refusals),
            }
        )
    joined = {
        name: (pa.concat_arrays if name == "segmentation" else np.concatenate)([part[name] for part in parts])
        for name in parts[0]
    }
    parts.clear()
    frame, refusals = joined["frame"], Refusals(joined["frame"], "jpg", problems)
    full = crowded(frame, refusals)
    rows = _keep(joined, full, refusals)
    wrong = ~np.isin(joined["category_id"], list(categories)) & ~full
    refusals.count(wrong, "field", "not in the list of categories", "category_id", _item(joined["category_id"]))
    tables = {"panoptic": _table(sequence, joined, rows), "categories": categories_table(sequence, categories)}
    known = np.setdiff1d(images.frame, frame[full])
    return Reading(tables, {"panoptic": known_frames(known, frame[rows])}, unknown)


def _keep(columns: dict[str, Any], full: Bools, refusals: Refusals) -> Ints:
    """Rows to keep, sorted by frame, category and track, those without a track last and in the file's order."""
    track = columns["object"]
    rows = np.flatnonzero(~full)
    order = np.lexsort((track[rows], track[rows] == NO_TRACK, columns["category_id"][rows], columns["frame"][rows]))
    rows = rows[order]
    same = np.zeros(len(rows), np.bool_)
    same[1:] = track[rows[1:]] != NO_TRACK
    for name in ("frame", "category_id", "object"):
        same[1:] &= columns[name][rows[1:]] == columns[name][rows[:-1]]
    again = mask_of(rows[same], len(track))
    refusals.count(again, "record", "same thing twice in a frame, the first is kept", "tracking_id", _item(track))
    return np.asarray(rows[~same])


def _table(sequence: str, columns: dict[str, Any], rows: Ints) -> pa.Table:
    track, box, area = (columns[name][rows] for name in ("object", "box", "area"))
    return pa.table(
        {
            "sequence": constant(sequence, len(rows)),
            "frame": columns["frame"][rows],
            "object": nullable(track, track == NO_TRACK, pa.int32()),
            "category_id": columns["category_id"][rows],
            **{name: nullable(box[:, i], np.isnan(box[:, i]), pa.float64()) for i, name in enumerate("xywh")},
            "area": nullable(area, np.isnan(area), pa.float64()),
            "segmentation": columns["segmentation"].take(pa.array(rows)),
        }
    ).cast(ANNOTATIONS["panoptic"])


def _item(values: Any) -> Any:
    """Shows the value of a row."""
    return lambda row: int(values[row])


# -- columns of a chunk --------------------------------------------------------------------------------------------


def _tracks(chunk: Sequence[Annotation], refusals: Refusals) -> Ints:
    """Track per annotation, NO_TRACK where there is none."""
    track = np.array(list(map(attrgetter("track"), chunk)), np.int64)
    wrong = (track < NO_TRACK) | (track > fields.MAX_TRACK)
    refusals.count(wrong, "field", "track: number out of range", "tracking_id", _item(track))
    track[wrong] = NO_TRACK
    return track


def _boxes(chunk: Sequence[Annotation]) -> Floats:
    """Boxes (n, 4), NaN where there is none: numbers of a file are finite by now."""
    none = (math.nan,) * 4
    box = [none if found is None else found for found in map(attrgetter("bbox"), chunk)]
    return np.array(box, np.float64).reshape(-1, 4)


def _segmentations(chunk: Sequence[Annotation], refusals: Refusals) -> pa.Array:
    """Masks as compact JSON, null where there is none."""
    texts: list[bytes | None] = []
    for row, raw in enumerate(map(bytes, map(attrgetter("segmentation"), chunk))):
        try:
            texts.append(None if raw in fields.ABSENT else _compact(raw))
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
    except (msgspec.DecodeError, RecursionError):
        raise ValueError("neither run lengths nor polygons") from None
    if isinstance(mask, list) and any(len(polygon) < 6 or len(polygon) % 2 for polygon in mask):
        raise ValueError("a polygon is not three or more pairs of numbers")
    return msgspec.json.format(raw, indent=-1)


# -- records that are not clean ------------------------------------------------------------------------------------


def _repair(raw: bytes, frame: str, problems: Problems) -> Annotation | None:
    """What can be used of a record that does not decode as it stands; None, with the reason counted, if nothing."""
    parts = record_parts(raw, frame, problems)
    if parts is None:
        return None
    where = place_of(parts)
    image = repaired_number(parts, "image_id", where, problems)
    category = None if image is None else repaired_number(parts, "category_id", where, problems)
    if image is None or category is None:
        return None
    return Annotation(
        image,
        category,
        _track(parts, where, problems),
        None,
        _box(parts.get("bbox", b"null"), where, problems),
        _area(parts.get("area", b"null"), where, problems),
        msgspec.Raw(parts.get("segmentation", b"")),
        where.removeprefix("annotation "),
    )


def _track(parts: dict[str, bytes], where: str, problems: Problems) -> int | None:
    """The first of the three names of the track that says anything; None, counted, where it cannot be used."""
    inner: dict[str, Any] = {}
    raw = parts.get("attributes", b"null")
    try:
        inner = {} if raw == b"null" else unpacked(raw, "attributes", where, problems)
    except ValueError as error:
        problems.add("field", str(error), frame=where, field="attributes", value=raw)
    raw = parts.get("tracking_id", b"null")
    try:
        values = [fields.loose(raw), inner.get("tracking_id"), inner.get("floor_id")]
        value = next((value for value in values if value is not None), None)
        return None if value is None else fields.whole(value, NO_TRACK, fields.MAX_TRACK)
    except ValueError as error:
        problems.add("field", f"track: {error}", frame=where, field="tracking_id", value=raw)
        return None


def _box(raw: bytes, where: str, problems: Problems) -> Box | None:
    if raw in fields.ABSENT:
        return None
    try:
        value = fields.loose(raw)
        if not isinstance(value, list) or len(value) != 4:
            raise ValueError("not four numbers")
        x, y, w, h = (fields.number(item) for item in value)
    except ValueError as error:
        problems.add("field", f"bbox: {error}", frame=where, field="bbox", value=raw)
        return None
    return x, y, w, h


def _area(raw: bytes, where: str, problems: Problems) -> float | None:
    try:
        value = fields.loose(raw)
        return None if value is None else fields.number(value)
    except ValueError as error:
        problems.add("field", str(error), frame=where, field="area", value=raw)
        return None


def _tracks_once(records: list[Annotation], written: WrittenKeys) -> bool:
    """Whether no name of a track is written more often than was decoded."""
    keys = (b'"tracking_id"', b'"floor_id"')
    outer = sum(map(is_not, map(attrgetter("tracking_id"), records), repeat(msgspec.UNSET)))
    # Only a file whose tracks stand inside is looked at record by record.
    return not written.exceed(outer, *keys) or not written.exceed(
        sum(n is not msgspec.UNSET for record in records for n in record.tracks), *keys
    )


_ANNOTATIONS: Final = ListReader(Annotation, _repair, ("image_id", "category_id", "bbox"), _tracks_once)
