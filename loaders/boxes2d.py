"""The stitched 2D layer with JRDB-Act: `labels_2d_stitched/<sequence>.json` -> annotation tables.

Boxes, actions, groups and social activities of one sequence, one row per fact, in stitched pixels. A frame is listed
in `frames` for the layer `2d` only if every person of it could be read: a frame with a refused person proves nobody's
absence and nothing unique. The layers `actions` and `groups` know the frames in which anybody has such a label.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import chain
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.schema.tables import ANNOTATIONS
from jrdb_avr.schema.vocabulary import ACTIONS, IMPOSSIBLE, OCCLUSIONS, normal_action

from . import fields
from .columns import Distinct, Ints, Refusals, constant, distinct_of, first_of_equal, known_frames, person_keys, ragged
from .labelfile import RecordReader, read_frames
from .problems import Problems, shorten
from .reading import Reading
from .records import BAD, OTHER, record_parts, repaired_label, track_codes, unpacked

CHUNK: Final = 20_000
"""Records whose columns are taken at once: decoded records are the largest thing in memory."""

_NOTHING: Final = msgspec.Raw(b"")


class Attributes(msgspec.Struct, gc=False, frozen=True):
    """The `attributes` object; null where missing."""

    occlusion: str | None = None
    truncated: bool | str | None = None
    interpolated: bool | None = None
    no_eval: bool | None = None


NO_ATTRIBUTES: Final = Attributes()


class Record(msgspec.Struct, gc=False):
    """One person in one frame. Sub-objects that repeat from frame to frame stay raw until each is decoded once."""

    label_id: str
    box: tuple[float, float, float, float]
    attributes: Attributes | None = None
    action_label: msgspec.Raw = _NOTHING
    social_group: msgspec.Raw = _NOTHING
    social_activity: msgspec.Raw = _NOTHING
    file_id: str | None = None


_RAW_FIELDS: Final = ("action_label", "social_group", "social_activity")
_READ_ONCE: Final = ("label_id", "box")
"""Keys whose repetition in a record is looked for; of other repeated keys JSON's usual reading, the last, holds."""


def load_2d(path: Path, sequence: str, problems: Problems) -> Reading:
    """Read a stitched 2D label file. Raises InputError if the file as a whole cannot be used."""
    columns = _Columns()
    reader = RecordReader(Record, _repair, _READ_ONCE)
    complete: list[int] = []
    for frame, key, raw in read_frames(path, ("jpg", "jpeg", "png"), problems):
        found = reader.read(raw, key, problems)
        if found is None:
            continue
        columns.add(frame, found[0])
        if found[1]:
            complete.append(frame)
    columns.flush()
    return _tables(columns, sequence, complete, problems)


# -- records that are not clean --------------------------------------------------------------------------------


def _repair(raw: bytes, frame: str, problems: Problems) -> Record | None:
    """What can be used of a record that does not decode as it stands; None, with the reason counted, if nothing."""
    parts = record_parts(raw, frame, problems)
    label = None if parts is None else repaired_label(parts, frame, problems)
    if parts is None or label is None:
        return None
    try:
        box = fields.loose(parts.get("box", b"null"))
        if not isinstance(box, list) or len(box) != 4:
            raise ValueError("not four numbers")
        x, y, w, h = (fields.number(value) for value in box)
    except ValueError as error:
        problems.add("record", f"box: {error}", frame=frame, field="box", value=parts.get("box", b"missing"))
        return None
    file_id = parts.get("file_id")
    record = Record(label, (x, y, w, h), _attributes(parts.get("attributes"), frame, problems))
    for name in _RAW_FIELDS:
        if name in parts:
            setattr(record, name, msgspec.Raw(parts[name]))
    try:
        record.file_id = None if file_id in (None, b"null") else fields.text(fields.loose(file_id or b""))
    except ValueError as error:
        problems.add("field", str(error), frame=frame, field="file_id", value=file_id)
    return record


def _attributes(raw: bytes | None, frame: str, problems: Problems) -> Attributes | None:
    if raw is None or raw == b"null":
        return None
    try:
        values = unpacked(raw, "attributes", frame, problems)
    except ValueError as error:
        problems.add("field", str(error), frame=frame, field="attributes", value=raw)
        return None
    usable: dict[str, Any] = {}
    # occlusion and truncated are judged with everybody's, by column.
    for name in ("occlusion", "truncated"):
        value = values.get(name)
        if isinstance(value, str | None) or (name == "truncated" and isinstance(value, bool)):
            usable[name] = value
        else:
            problems.add("field", "not a text", frame=frame, field=f"attributes.{name}", value=value)
    for name in ("interpolated", "no_eval"):
        value = values.get(name)
        try:
            usable[name] = None if value is None else fields.flag(value)
        except ValueError as error:
            problems.add("field", str(error), frame=frame, field=f"attributes.{name}", value=value)
    return Attributes(**usable)


# -- columns -----------------------------------------------------------------------------------------------------


class _Columns:
    """Records turned into numbers, chunk by chunk."""

    def __init__(self) -> None:
        self.codes = {name: Distinct() for name in ("label_id", "attributes", "file_id", *_RAW_FIELDS)}
        self.parts: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in ("frame", "box", *self.codes)}
        self._records: list[Record] = []
        self._frames: list[int] = []
        self._counts: list[int] = []

    def add(self, frame: int, records: list[Record]) -> None:
        self._records += records
        self._frames.append(frame)
        self._counts.append(len(records))
        if len(self._records) >= CHUNK:
            self.flush()

    def flush(self) -> None:
        records, n = self._records, len(self._records)
        self.parts["frame"].append(np.repeat(np.array(self._frames, np.int64), self._counts))
        boxes = np.fromiter(chain.from_iterable(map(attrgetter("box"), records)), np.float64, 4 * n)
        self.parts["box"].append(boxes.reshape(n, 4))
        values: dict[str, Any] = {
            name: map(attrgetter(name), records) for name in ("label_id", "attributes", "file_id")
        }
        for name in _RAW_FIELDS:
            values[name] = map(bytes, map(attrgetter(name), records))
        for name, column in values.items():
            self.parts[name].append(np.fromiter(map(self.codes[name].__getitem__, column), np.int64, n))
        self._records, self._frames, self._counts = [], [], []

    def column(self, name: str) -> npt.NDArray[Any]:
        return np.concatenate(self.parts[name])


def _tables(columns: _Columns, sequence: str, complete: list[int], problems: Problems) -> Reading:
    frame: Ints = columns.column("frame")
    refusals = Refusals(frame, "jpg", problems)
    track, rows, partial = _keep(columns, frame, refusals)
    kept = _Kept(sequence, frame[rows], track[rows], {name: columns.column(name)[rows] for name in _RAW_FIELDS})
    # Rows are sorted by person from here on; the first example of a problem is then the first by frame.
    refusals = Refusals(kept.frame, "jpg", problems)
    unknown: Counter[tuple[str, str]] = Counter()
    actions = _expand(kept, "action_label", columns, _action_list, refusals)
    groups = _expand(kept, "social_group", columns, _group, refusals)
    activities = _expand(kept, "social_activity", columns, _activity_list, refusals)
    for field, rows_of in (("action_label", actions), ("social_activity", activities)):
        for code, n in zip(*np.unique(rows_of.codes, return_counts=True), strict=True):
            label = rows_of.values[code][0]
            if label not in ACTIONS:
                unknown[field, label] += int(n)

    listed = np.zeros(len(kept.frame), np.bool_)
    listed[actions.row] = True
    tables = {
        "boxes_2d": _box_table(columns, rows, kept, listed, refusals),
        "actions": actions.table("actions", kept, ("action", "raw", "difficulty")),
        "groups": groups.table("groups", kept, ("cluster", "difficulty")),
        "social_activities": activities.table("social_activities", kept, ("activity", "value")),
    }
    known = np.array(sorted(set(complete) - partial), np.int64)
    layers = {
        "2d": known_frames(known, kept.frame),
        "actions": known_frames(distinct_of(kept.frame[listed]), kept.frame[listed]),
        "groups": known_frames(distinct_of(kept.frame[groups.row]), kept.frame[groups.row]),
    }
    return Reading(tables, layers, unknown)


class _Kept:
    """The usable person boxes, sorted by (frame, track), with the codes of their raw sub-objects."""

    def __init__(self, sequence: str, frame: Ints, track: Ints, codes: dict[str, Ints]) -> None:
        self.sequence = sequence
        self.frame = frame
        self.track = track
        self.codes = codes


def _keep(columns: _Columns, frame: Ints, refusals: Refusals) -> tuple[Ints, Ints, set[int]]:
    """Track per record, the rows to keep sorted by (frame, track), and the frames with a refused person."""
    labels = list(columns.codes["label_id"])
    code = columns.column("label_id")
    track = track_codes(labels, code)
    box = columns.column("box")

    def label(row: int) -> object:
        return labels[code[row]]

    def size(row: int) -> object:
        return box[row].tolist()

    refusals.count(track == OTHER, "record", "label_id is not of a tracked person", "label_id", label)
    refusals.count(track == BAD, "record", "label_id is not pedestrian:N", "label_id", label)
    person = track >= 0
    wild = person & ~(np.abs(box) <= fields.MAX_PIXEL).all(axis=1)
    refusals.count(wild, "record", "box: not finite or far outside the image", "box", size)
    flat = person & ~wild & ~((box[:, 2] > 0) & (box[:, 3] > 0))
    refusals.count(flat, "record", "box: width or height is not positive", "box", size)
    usable = np.flatnonzero(person & ~wild & ~flat)
    order, first = first_of_equal(person_keys(frame[usable], track[usable]))
    again = np.zeros(len(frame), np.bool_)
    again[usable[order[~first]]] = True
    refusals.count(again, "record", "same person twice in a frame, the first is kept", "label_id", label)
    return track, usable[order[first]], set(frame[wild | flat | (track == BAD)].tolist())


def _box_table(
    columns: _Columns, rows: Ints, kept: _Kept, listed: npt.NDArray[np.bool_], refusals: Refusals
) -> pa.Table:
    box = columns.column("box")[rows]
    code = columns.column("attributes")[rows]
    distinct: list[Attributes | None] = list(columns.codes["attributes"])
    known = [item or NO_ATTRIBUTES for item in distinct]
    refused = np.array([item.occlusion is not None and item.occlusion not in OCCLUSIONS for item in known], np.bool_)
    if refused.any():
        refusals.count(
            refused[code], "field", "unknown word", "attributes.occlusion", lambda row: known[code[row]].occlusion
        )
    occlusion = [None if bad else item.occlusion for item, bad in zip(known, refused, strict=True)]
    by_code = pa.array(code)
    n = len(rows)
    values = {
        "sequence": constant(kept.sequence, n),
        "frame": kept.frame,
        "track": kept.track,
        **{name: box[:, i] for i, name in enumerate("xywh")},
        "has_attributes": pa.array([item is not None for item in distinct], pa.bool_()).take(by_code),
        "occlusion": pa.array(occlusion, pa.string()).take(by_code),
        "truncated": _truncated(known, code, refusals),
        "interpolated": pa.array([item.interpolated for item in known], pa.bool_()).take(by_code),
        "no_eval": pa.array([item.no_eval for item in known], pa.bool_()).take(by_code),
        "has_actions": listed,
        "file_id": _file_ids(columns, rows),
    }
    return pa.table(values).cast(ANNOTATIONS["boxes_2d"])


def _truncated(known: list[Attributes], code: Ints, refusals: Refusals) -> pa.Array:
    words = [item.truncated for item in known]
    values: list[bool | None] = []
    refused = np.zeros(len(words), np.bool_)
    for i, word in enumerate(words):
        try:
            values.append(None if word is None else fields.flag(word))
        except ValueError:
            values.append(None)
            refused[i] = True
    if refused.any():
        refusals.count(
            refused[code], "field", "neither true nor false", "attributes.truncated", lambda row: words[code[row]]
        )
    return pa.array(values, pa.bool_()).take(pa.array(code))


def _file_ids(columns: _Columns, rows: Ints) -> pa.Array:
    values: list[str | None] = []
    for value in columns.codes["file_id"]:
        try:
            values.append(None if value is None else fields.text(value))
        except ValueError:
            values.append(None)
    return pa.array(values, pa.string()).take(pa.array(columns.column("file_id")[rows]))


# -- raw sub-objects, each distinct one decoded once -------------------------------------------------------------


class _Rows:
    """Facts of a sub-object: for each its row in the kept boxes, and its number in `values`."""

    def __init__(self, row: Ints, codes: Ints, values: list[tuple[Any, ...]]) -> None:
        self.row = row
        self.codes = codes
        self.values = values

    def table(self, layer: str, kept: _Kept, names: tuple[str, ...]) -> pa.Table:
        """The annotation table, with the columns `names` taken from the values, sorted by frame, track and value."""
        rank = np.empty(len(self.values), np.int64)
        rank[sorted(range(len(self.values)), key=lambda i: tuple((v is None, v or 0) for v in self.values[i]))] = (
            np.arange(len(self.values))
        )
        order = np.lexsort((rank[self.codes] if len(self.values) else self.codes, self.row))
        row, codes = self.row[order], pa.array(self.codes[order])
        schema = ANNOTATIONS[layer]
        columns = {"sequence": constant(kept.sequence, len(row)), "frame": kept.frame[row], "track": kept.track[row]}
        for i, name in enumerate(names):
            columns[name] = pa.array([value[i] for value in self.values], schema.field(name).type).take(codes)
        return pa.table(columns).cast(schema)


_Issue = tuple[str, str, object]
"""Reason, field and offending value."""


def _expand(
    kept: _Kept,
    field: str,
    columns: _Columns,
    decode: Callable[[bytes], tuple[list[tuple[Any, ...]], list[_Issue]]],
    refusals: Refusals,
) -> _Rows:
    codes = kept.codes[field]
    numbers = Distinct()
    members_of: list[list[int]] = []
    issues_of: dict[int, list[_Issue]] = {}
    for i, raw in enumerate(columns.codes[field]):
        values, issues = ([], []) if raw in (b"", b"null") else decode(raw)
        members_of.append([numbers[value] for value in values])
        if issues:
            issues_of[i] = issues
    if issues_of:
        # By first row, so that the first example of a problem is the first by frame.
        for code, begin, count in sorted(zip(*_firsts(codes), strict=True), key=itemgetter(1)):
            for reason, name, value in issues_of.get(code, ()):
                refusals.add("field", reason, name, begin, value, count)
    flat = np.array(list(chain.from_iterable(members_of)), np.int64)
    lengths = np.array([len(numbered) for numbered in members_of], np.int64)
    starts = np.cumsum(lengths) - lengths
    row, place = ragged(lengths[codes] if len(codes) else codes)
    taken = flat[starts[codes[row]] + place] if len(row) else row
    return _Rows(row, taken, list(numbers))


def _firsts(codes: Ints) -> tuple[list[int], list[int], list[int]]:
    """Every code that occurs, its first row and how often it occurs."""
    found, first, counts = np.unique(codes, return_index=True, return_counts=True)
    return found.tolist(), first.tolist(), counts.tolist()


def _named(raw: bytes, field: str) -> tuple[list[tuple[str, str, Any]], list[_Issue]]:
    """Members of a label object as (label, raw label, value), and what is wrong with it."""
    issues: list[_Issue] = []
    try:
        items, again = fields.pairs(raw)
    except ValueError as error:
        return [], [(str(error), field, raw)]
    issues += [("key twice, the first is kept", f"{field}.{shorten(name)}", "") for name in again]
    named = []
    for name, value in items:
        try:
            written = fields.text(name)
        except ValueError as error:
            issues.append((f"label: {error}", field, name))
        else:
            named.append((normal_action(written), written, value))
    return named, issues


def _action_list(raw: bytes) -> tuple[list[tuple[Any, ...]], list[_Issue]]:
    named, issues = _named(raw, "action_label")
    rows: list[tuple[Any, ...]] = []
    for action, written, value in named:
        if action == IMPOSSIBLE:
            continue
        try:
            code = fields.difficulty(value)
        except ValueError as error:
            issues.append((f"difficulty: {error}", "action_label", value))
            rows.append((action, written, None))
        else:
            rows.append((action, written, code))
    return rows, issues


def _activity_list(raw: bytes) -> tuple[list[tuple[Any, ...]], list[_Issue]]:
    named, issues = _named(raw, "social_activity")
    rows: list[tuple[Any, ...]] = []
    for activity, _, value in named:
        try:
            rows.append((activity, fields.number(value)))
        except ValueError as error:
            issues.append((f"value: {error}", "social_activity", value))
            rows.append((activity, None))
    return rows, issues


def _group(raw: bytes) -> tuple[list[tuple[Any, ...]], list[_Issue]]:
    try:
        items, again = fields.pairs(raw)
    except ValueError as error:
        return [], [(str(error), "social_group", raw)]
    issues: list[_Issue] = [("key twice, the first is kept", f"social_group.{shorten(name)}", "") for name in again]
    values = dict(items)
    try:
        cluster = fields.whole(values.get("cluster_ID"), -(2**62), 2**62)
    except ValueError as error:
        return [], [*issues, (str(error), "social_group.cluster_ID", values.get("cluster_ID"))]
    try:
        return [(cluster, fields.difficulty(values.get("cluster_stat")))], issues
    except ValueError as error:
        return [(cluster, None)], [*issues, (str(error), "social_group.cluster_stat", values.get("cluster_stat"))]
