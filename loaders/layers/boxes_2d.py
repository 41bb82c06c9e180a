"""The stitched 2D layer with JRDB-Act: `labels_2d_stitched/<sequence>.json` -> annotation tables.

Boxes, actions, groups and social activities of one sequence, one row per fact, in stitched pixels. A frame is listed
in `frames` for the layer `2d` only if every person of it could be read: a frame with a refused person proves nobody's
absence and nothing unique. The layers `actions` and `groups` know the frames in which anybody has such a label.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa

from jrdb_avr.loaders.labelfiles import records
from jrdb_avr.loaders.labelfiles.columns import Columns, Distinct, LayerTables, Refusals, known_frames, mask_of, spread
from jrdb_avr.loaders.labelfiles.facts import ColumnFacts, Decoded, KeptRecords, expand, facts_table, keep_people
from jrdb_avr.loaders.labelfiles.frames import gather, take_fields
from jrdb_avr.loaders.labelfiles.json import ABSENT, NOTHING
from jrdb_avr.loaders.labelfiles.record_reader import Fields, RecordReader
from jrdb_avr.loaders.labelfiles.records import Rule, optional
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import ACTIONS, IMPOSSIBLE, OCCLUSIONS, normal_action

SUFFIXES: Final = ("jpg", "jpeg", "png")


class Attributes2D(msgspec.Struct, gc=False, frozen=True):
    """The `attributes` object; null where missing."""

    occlusion: str | None = None
    truncated: bool | str | None = None
    interpolated: bool | None = None
    no_eval: bool | None = None


class Record2D(msgspec.Struct, gc=False):
    """One person in one frame. Sub-objects that repeat from frame to frame stay raw until each is decoded once."""

    label_id: str
    box: tuple[float, float, float, float]
    attributes: Attributes2D | None = None
    action_label: msgspec.Raw = NOTHING
    social_group: msgspec.Raw = NOTHING
    social_activity: msgspec.Raw = NOTHING
    file_id: str | None = None


PERSON: Final = {
    "label_id": Rule(records.label_id, "record"),
    "box": Rule(records.box, "record", "box: "),
}
"""Rules of the fields that every record of people has."""

_ATTRIBUTES: Final = {
    "occlusion": Rule(optional(records.string)),
    "truncated": Rule(optional(lambda value: value if isinstance(value, bool) else records.string(value))),
    "interpolated": Rule(optional(records.flag)),
    "no_eval": Rule(optional(records.flag)),
}


def _attributes(**fields: Any) -> Attributes2D:
    """Attributes of the fields that could be read. Who may be left out of evaluation is in no clear view: where
    `no_eval` could not be read, the occlusion is not known either."""
    return Attributes2D(**fields if "no_eval" in fields else fields | {"occlusion": None})


def _unread_attributes(parts: dict[str, bytes], frame: str, problems: Problems) -> dict[str, Any]:
    """Attributes of a record that wrote some that cannot be read: a sequence without any shows everybody clearly."""
    return {} if parts.get("attributes", b"") in ABSENT else {"attributes": Attributes2D()}


_READER: Final = RecordReader(
    Record2D,
    PERSON | {"attributes": Rule(_ATTRIBUTES, make=_attributes), "file_id": Rule(optional(records.text))},
    # Of other repeated keys JSON's usual reading, the last, holds.
    once=("label_id", "box", "attributes", "action_label", "social_group", "social_activity"),
    more=_unread_attributes,
)
_CODED: Final = ("label_id", "attributes", "file_id", "action_label", "social_group", "social_activity")


def load_2d(path: Path, problems: Problems) -> LayerTables:
    """Read a stitched 2D label file. Raises InputError if the file as a whole cannot be used."""
    codes: dict[str, Distinct] = defaultdict(Distinct)
    columns, _, complete = gather(path, SUFFIXES, _READER, lambda fields: take_people(fields, _CODED, codes), problems)
    box = columns["box"]
    refusals = Refusals(columns["frame"], problems)
    people = keep_people(columns, codes, refusals, box_faults(box), lambda row: box[row].tolist())
    # Rows are sorted by person from here on; the first example of a problem is then the first by frame.
    refusals = Refusals(people.frame, problems)
    columns = {name: column[people.row] for name, column in columns.items()}

    def expanded(field: str, decode: Callable[[bytes, Decoded], None]) -> ColumnFacts:
        return expand(columns[field], codes[field], decode, refusals)

    actions, groups = expanded("action_label", _actions), expanded("social_group", _group)
    activities = expanded("social_activity", _activities)
    labelled = mask_of(actions.row, len(people.row))
    return LayerTables(
        {
            "boxes_2d": _box_table(columns, codes, people, labelled & actions.whole, refusals),
            "actions": facts_table("actions", people, actions, ("action", "raw", "difficulty")),
            "groups": facts_table("groups", people, groups, ("cluster", "difficulty")),
            "social_activities": facts_table("social_activities", people, activities, ("activity", "value")),
        },
        {
            "2d": known_frames(people.whole_frames(complete), people.frame),
            "actions": people.frames_of(actions.row),
            "groups": people.frames_of(groups.row),
        },
        actions.tally(lambda value: None if value[0] in ACTIONS else ("action_label", value[0]))
        + activities.tally(lambda value: None if value[0] in ACTIONS else ("social_activity", value[0])),
    )


def take_people(fields: Fields, coded: tuple[str, ...], codes: dict[str, Distinct]) -> Columns:
    """The column `box` and the numbered columns of records of people."""
    boxes = fields["box"]
    numbers = np.fromiter(chain.from_iterable(boxes), np.float64, 4 * len(boxes))
    return {"box": numbers.reshape(-1, 4), **take_fields(fields, coded, codes)}


def box_faults(box: npt.NDArray[np.float64]) -> list[tuple[Bools, str]]:
    """Boxes that cannot be used, and why."""
    return [
        (np.asarray(~(np.abs(box) <= records.MAX_PIXEL).all(axis=1)), "box: not finite or far outside the image"),
        (np.asarray(~((box[:, 2] > 0) & (box[:, 3] > 0))), "box: width or height is not positive"),
    ]


def usable_boxes(box: npt.NDArray[np.float64], refusals: Refusals, field: str) -> Bools:
    """Which boxes can be used; the others are reported, except missing ones (NaN)."""
    usable = ~np.isnan(box[:, 0])
    for fault, reason in box_faults(box):
        refusals.count(usable & fault, "field", reason, field, lambda row: box[row].tolist())
        usable &= ~fault
    return usable


def _box_table(
    columns: Columns, codes: dict[str, Distinct], people: KeptRecords, listed: Bools, refusals: Refusals
) -> pa.Table:
    box, code = columns["box"], columns["attributes"]
    known = [item or Attributes2D() for item in codes["attributes"]]

    def attribute(name: str, read: Callable[[Any], Any] | None, kind: pa.DataType) -> pa.Array:
        return _taken([getattr(item, name) for item in known], code, kind, read, f"attributes.{name}", refusals)

    return pa.table(
        {
            "frame": people.frame,
            "track": people.track,
            **{name: box[:, i] for i, name in enumerate("xywh")},
            "has_attributes": _taken([item is not None for item in codes["attributes"]], code, pa.bool_()),
            "occlusion": attribute("occlusion", _occlusion, pa.string()),
            "truncated": attribute("truncated", records.flag, pa.bool_()),
            "interpolated": attribute("interpolated", None, pa.bool_()),
            "no_eval": attribute("no_eval", None, pa.bool_()),
            "has_actions": listed,
            "file_id": _taken(list(codes["file_id"]), columns["file_id"], pa.string(), records.text),
        }
    )


def _taken(
    values: list[Any],
    code: Ints,
    kind: pa.DataType,
    read: Callable[[Any], Any] | None = None,
    field: str = "",
    refusals: Refusals | None = None,
) -> pa.Array:
    """The column `values[code]`, each distinct value read once; null, and counted, where it cannot be read."""
    usable: list[Any] = []
    wrong: dict[int, str] = {}
    for i, value in enumerate(values):
        try:
            usable.append(value if value is None or read is None else read(value))
        except ValueError as error:
            usable.append(None)
            wrong[i] = str(error)
    if refusals is not None and wrong:
        refused = np.isin(code, list(wrong))
        refusals.count(refused, "field", next(iter(wrong.values())), field, lambda row: values[code[row]])
    return spread(usable, kind, code)


def _occlusion(value: str) -> str:
    if value not in OCCLUSIONS:
        raise ValueError("unknown word")
    return value


# -- raw sub-objects -----------------------------------------------------------------------------------------------


def _actions(raw: bytes, found: Decoded) -> None:
    for label, code in found.labels(raw, "action_label"):
        action = normal_action(label)
        found.whole &= action in ACTIONS
        if action != IMPOSSIBLE:
            found.values.append((action, label, found.difficulty(code, "action_label")))


def _activities(raw: bytes, found: Decoded) -> None:
    for label, value in found.labels(raw, "social_activity"):
        number = found.read(records.number, value, "social_activity", "value: ")
        found.values.append((normal_action(label), number))


def _group(raw: bytes, found: Decoded) -> None:
    values = found.members(raw, "social_group")
    if values is None:
        return
    cluster = found.read(_cluster, values.get("cluster_ID"), "social_group.cluster_ID")
    if cluster is not None:
        code = found.read(records.difficulty, values.get("cluster_stat"), "social_group.cluster_stat")
        found.values.append((cluster, code))


def _cluster(value: object) -> int:
    return records.whole(value, -(2**62), 2**62)
