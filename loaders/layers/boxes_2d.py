"""The stitched 2D layer with JRDB-Act: `labels_2d_stitched/<sequence>.json` -> annotation tables.

Boxes, actions, groups and social activities of one sequence, one row per fact, in stitched pixels. A frame is listed
in `frames` for the layer `2d` only if every person of it could be read: a frame with a refused person proves nobody's
absence and nothing unique. The layers `actions` and `groups` know the frames in which anybody has such a label.
"""

from __future__ import annotations

from collections import Counter
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records as fields
from jrdb_avr.loaders.labelfiles.columns import (
    Distinct,
    Refusals,
    constant,
    distinct_of,
    encoded,
    known_frames,
    mask_of,
)
from jrdb_avr.loaders.labelfiles.expand import Decoded, Issue, Value, coded, expand, facts_table, label_pairs
from jrdb_avr.loaders.labelfiles.frames import RecordReader
from jrdb_avr.loaders.labelfiles.gather import Columns, People, gather, keep_people, numbered
from jrdb_avr.loaders.labelfiles.records import record_parts, repaired_box, repaired_label, unpacked
from jrdb_avr.loaders.layers.layer import Reading
from jrdb_avr.loaders.problems import Problems, shorten
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import ACTIONS, IMPOSSIBLE, OCCLUSIONS, normal_action
from jrdb_avr.schema.tables import ANNOTATIONS

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
_READ_ONCE: Final = ("label_id", "box", "attributes", *_RAW_FIELDS)
"""Keys of which a record keeps the first. Of other repeated keys JSON's usual reading, the last, holds."""

SUFFIXES: Final = ("jpg", "jpeg", "png")


def load_2d(path: Path, sequence: str, problems: Problems) -> Reading:
    """Read a stitched 2D label file. Raises InputError if the file as a whole cannot be used."""
    codes = {name: Distinct() for name in ("label_id", "attributes", "file_id", *_RAW_FIELDS)}
    reader = RecordReader(Record, _repair, _READ_ONCE)
    gathered = gather(path, SUFFIXES, reader, lambda records: _take(records, codes), problems)
    columns = gathered.columns()
    people = _kept(columns, list(codes["label_id"]), problems)
    return _tables(columns, codes, people, _complete(gathered.complete, people), sequence, problems)


def _complete(frames: list[int], people: People) -> Ints:
    """Of frames whose records all decoded, those of which nobody is refused, ascending."""
    return np.array(sorted(set(frames) - people.partial), np.int64)


# -- records that are not clean --------------------------------------------------------------------------------


def _repair(raw: bytes, frame: str, problems: Problems) -> Record | None:
    """What can be used of a record that does not decode as it stands; None, with the reason counted, if nothing."""
    parts = record_parts(raw, frame, problems)
    label = None if parts is None else repaired_label(parts, frame, problems)
    if parts is None or label is None:
        return None
    box = repaired_box(parts, frame, problems)
    if box is None:
        return None
    file_id = parts.get("file_id")
    record = Record(label, box, _attributes(parts.get("attributes"), frame, problems))
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


def take_boxes(records: list[Any], labels: Distinct) -> Columns:
    """The columns `label_id` (numbers of `labels`) and `box`, of records that have these fields."""
    boxes = np.fromiter(chain.from_iterable(map(attrgetter("box"), records)), np.float64, 4 * len(records))
    return {
        "label_id": numbered(labels, map(attrgetter("label_id"), records), len(records)),
        "box": boxes.reshape(len(records), 4),
    }


def box_faults(box: npt.NDArray[np.float64]) -> list[tuple[Bools, str]]:
    """Boxes that cannot be used, and why."""
    return [
        (np.asarray(~(np.abs(box) <= fields.MAX_PIXEL).all(axis=1)), "box: not finite or far outside the image"),
        (np.asarray(~((box[:, 2] > 0) & (box[:, 3] > 0))), "box: width or height is not positive"),
    ]


def _kept(columns: Columns, labels: list[str], problems: Problems) -> People:
    frame, box = columns["frame"], columns["box"]
    refusals = Refusals(frame, "jpg", problems)
    return keep_people(frame, labels, columns["label_id"], box_faults(box), lambda row: box[row].tolist(), refusals)


def _take(records: list[Record], codes: dict[str, Distinct]) -> Columns:
    n = len(records)
    columns = take_boxes(records, codes["label_id"])
    for name in ("attributes", "file_id"):
        columns[name] = numbered(codes[name], map(attrgetter(name), records), n)
    for name in _RAW_FIELDS:
        columns[name] = numbered(codes[name], map(bytes, map(attrgetter(name), records)), n)
    return columns


def _tables(
    columns: Columns,
    codes: dict[str, Distinct],
    people: People,
    complete: Ints,
    sequence: str,
    problems: Problems,
) -> Reading:
    # Rows are sorted by person from here on; the first example of a problem is then the first by frame.
    refusals = Refusals(people.frame, "jpg", problems)
    columns = {name: column[people.row] for name, column in columns.items()}
    decoders = {"action_label": _action_list, "social_group": _group, "social_activity": _activity_list}
    facts = {name: expand(columns[name], codes[name], decode, refusals) for name, decode in decoders.items()}
    actions, groups = facts["action_label"], facts["social_group"]
    unknown = Counter(
        {
            (field, label): n
            for field in ("action_label", "social_activity")
            for label, n in facts[field].labels().items()
            if label not in ACTIONS
        }
    )
    labelled = mask_of(actions.row, len(people.frame))

    def table(layer: str, field: str, names: tuple[str, ...]) -> pa.Table:
        row = facts[field].row
        keys = {"frame": people.frame[row], "track": people.track[row]}
        return facts_table(layer, sequence, keys, facts[field].code, facts[field].values, names)

    tables = {
        "boxes_2d": _box_table(columns, codes, people, sequence, labelled & actions.whole, refusals),
        "actions": table("actions", "action_label", ("action", "raw", "difficulty")),
        "groups": table("groups", "social_group", ("cluster", "difficulty")),
        "social_activities": table("social_activities", "social_activity", ("activity", "value")),
    }
    layers = {
        "2d": known_frames(complete, people.frame),
        "actions": frames_of(people.frame[labelled]),
        "groups": frames_of(people.frame[groups.row]),
    }
    return Reading(tables, layers, unknown)


def frames_of(frame: Ints) -> tuple[Ints, Ints]:
    """The frames of people in order, as a layer of the `frames` table."""
    return known_frames(distinct_of(frame), frame)


def _box_table(
    columns: Columns,
    codes: dict[str, Distinct],
    people: People,
    sequence: str,
    listed: Bools,
    refusals: Refusals,
) -> pa.Table:
    box, code = columns["box"], columns["attributes"]
    distinct: list[Attributes | None] = list(codes["attributes"])
    known = [item or NO_ATTRIBUTES for item in distinct]
    refused = np.array([item.occlusion is not None and item.occlusion not in OCCLUSIONS for item in known], np.bool_)
    if refused.any():
        refusals.count(
            refused[code], "field", "unknown word", "attributes.occlusion", lambda row: known[code[row]].occlusion
        )
    occlusion = [None if bad else item.occlusion for item, bad in zip(known, refused, strict=True)]
    by_code = pa.array(code)
    values = {
        "sequence": constant(sequence, len(box)),
        "frame": people.frame,
        "track": people.track,
        **{name: box[:, i] for i, name in enumerate("xywh")},
        "has_attributes": pa.array([item is not None for item in distinct], pa.bool_()).take(by_code),
        "occlusion": pa.array(occlusion, pa.string()).take(by_code),
        "truncated": _truncated(known, code, refusals),
        "interpolated": pa.array([item.interpolated for item in known], pa.bool_()).take(by_code),
        "no_eval": pa.array([item.no_eval for item in known], pa.bool_()).take(by_code),
        "has_actions": listed,
        "file_id": _file_ids(list(codes["file_id"]), columns["file_id"]),
    }
    return encoded(pa.table(values), ANNOTATIONS["boxes_2d"])


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


def _file_ids(distinct: list[str | None], code: Ints) -> pa.Array:
    values: list[str | None] = []
    for value in distinct:
        try:
            values.append(None if value is None else fields.text(value))
        except ValueError:
            values.append(None)
    return pa.array(values, pa.string()).take(pa.array(code))


# -- raw sub-objects ---------------------------------------------------------------------------------------------


def _action_list(raw: bytes) -> Decoded:
    named, issues, whole = label_pairs(raw, "action_label")
    rows: list[Value] = []
    for written, value in named:
        action = normal_action(written)
        if action != IMPOSSIBLE:
            rows.append((action, written, coded(value, "action_label", issues)))
    return Decoded(rows, issues, whole)


def _activity_list(raw: bytes) -> Decoded:
    named, issues, whole = label_pairs(raw, "social_activity")
    rows: list[Value] = []
    for written, value in named:
        try:
            rows.append((normal_action(written), fields.number(value)))
        except ValueError as error:
            issues.append((f"value: {error}", "social_activity", value))
            rows.append((normal_action(written), None))
    return Decoded(rows, issues, whole)


def _group(raw: bytes) -> Decoded:
    try:
        items, again = fields.pairs(raw)
    except ValueError as error:
        return Decoded([], [(str(error), "social_group", raw)], False)
    issues: list[Issue] = [("key twice, the first is kept", f"social_group.{shorten(name)}", "") for name in again]
    values = dict(items)
    try:
        cluster = fields.whole(values.get("cluster_ID"), -(2**62), 2**62)
    except ValueError as error:
        issues.append((str(error), "social_group.cluster_ID", values.get("cluster_ID")))
        return Decoded([], issues, False)
    try:
        difficulty = fields.difficulty(values.get("cluster_stat"))
    except ValueError as error:
        issues.append((str(error), "social_group.cluster_stat", values.get("cluster_stat")))
        return Decoded([(cluster, None)], issues, False)
    return Decoded([(cluster, difficulty)], issues)
