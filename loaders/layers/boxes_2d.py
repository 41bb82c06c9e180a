"""Loader of the 2D layer with the labels of JRDB-Act, from `labels_2d_stitched/<sequence>.json`.

The loader makes the annotation tables of boxes, actions, groups and social activities, with one row per fact. Boxes are
in pixels of the stitched panorama.

The table `frames` lists a frame for the layer `2d` only if none of the frame's records of people was refused. A frame
with a refused record could not prove that a person is absent, or that a description fits only one person. For the layer
`actions`, the table `frames` lists the frames with at least one action label. For the layer `groups`, the table lists
the frames with at least one group label.
"""

from __future__ import annotations

import math
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
from jrdb_avr.loaders.labelfiles.frames import Fields, RecordReader, gather, take_fields
from jrdb_avr.loaders.labelfiles.records import NOTHING
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import ACTIONS, IMPOSSIBLE, OCCLUSIONS, normal_action
from jrdb_avr.schema.panorama import HEIGHT, WIDTH

SUFFIXES: Final = ("jpg", "jpeg", "png")
"""Suffixes of the keys of frames."""

StitchedBox = tuple[float, float, float, float]
"""Left edge, top edge, width and height of a box in pixels of the stitched panorama."""


NO_BOX: Final[StitchedBox] = (math.nan,) * 4
"""Value that stands for a missing box."""


class Attributes2D(msgspec.Struct, gc=False, frozen=True):
    """The object `attributes` of a record. A missing attribute is None."""

    occlusion: str | None = None
    truncated: bool | str | None = None
    interpolated: bool | None = None
    no_eval: bool | None = None


class Record2D(msgspec.Struct, gc=False):
    """Record of one person in one frame.

    The sub-objects `action_label`, `social_group` and `social_activity` are often the same in many frames. They are
    kept as raw bytes, and each distinct sub-object is decoded later, only once.
    """

    label_id: str
    box: StitchedBox
    attributes: Attributes2D | None = None
    action_label: msgspec.Raw = NOTHING
    social_group: msgspec.Raw = NOTHING
    social_activity: msgspec.Raw = NOTHING
    file_id: str | None = None


_READER: Final = RecordReader(Record2D)
_FACTORS: Final = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93], np.uint64)
"""Odd factors for the hash of a box."""
_CODED: Final = ("label_id", "attributes", "file_id", "action_label", "social_group", "social_activity")


def load_2d(path: Path, problems: Problems) -> LayerTables:
    """Read a stitched 2D label file.

    Args:
        path: label file.
        problems: counter of refused parts.

    Returns:
        The tables of boxes, actions, groups and social activities, and the frames of each layer.

    Raises:
        InputError: If the file as a whole cannot be used.
    """
    codes: dict[str, Distinct] = defaultdict(Distinct)
    columns, _, complete = gather(path, SUFFIXES, _READER, lambda fields: take_people(fields, _CODED, codes), problems)
    box = columns["box"]
    refusals = Refusals(columns["frame"], problems)
    people = keep_people(columns, codes, refusals, box_faults(box), lambda row: box[row].tolist())
    # From here on, rows are sorted by frame and person, so a counter with the frames in the new order is needed.
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
    """Return the columns of a batch of records.

    Args:
        fields: fields of the records.
        coded: names of the fields that become columns of codes.
        codes: by name of a field, the dictionary from the field's distinct values to their codes. New values are added
            to the dictionary.

    Returns:
        The column `box` of shape (n, 4), and a column of codes for each field in `coded`.
    """
    boxes = fields["box"]
    numbers = np.fromiter(chain.from_iterable(boxes), np.float64, 4 * len(boxes))
    return {"box": numbers.reshape(-1, 4), **take_fields(fields, coded, codes)}


def box_faults(box: npt.NDArray[np.float64]) -> list[tuple[Bools, str]]:
    """Check boxes for each kind of fault. Return one pair (mask, text) per kind of fault.

    The mask is True at each box with the fault. The text describes the fault in the load report. The argument `box`
    has the shape (n, 4).
    """
    return [
        (np.asarray(~(np.abs(box) <= records.MAX_PIXEL).all(axis=1)), "box: not finite or far outside the image"),
        (np.asarray(~((box[:, 2] > 0) & (box[:, 3] > 0))), "box: width or height is not positive"),
    ]


def usable_boxes(box: npt.NDArray[np.float64], refusals: Refusals, field: str) -> Bools:
    """Return a mask of the usable boxes, and count the unusable boxes in `refusals`.

    `box` has the shape (n, 4). A missing box (NaN) is unusable, but it is not counted.
    """
    usable = ~np.isnan(box[:, 0])
    for fault, reason in box_faults(box):
        refusals.count(usable & fault, "field", reason, field, lambda row: box[row].tolist())
        usable &= ~fault
    return usable


def box_warnings(boxes: pa.Table) -> list[str]:
    """Return a line of warning if the numbers of the boxes look like another form than pixels of the panorama.

    Args:
        boxes: table with the columns x, y, w and h, as they are in the file.

    Returns:
        A list with at most one line, which names the likeliest form.
    """
    x, y, w, h = (boxes[name].to_numpy() for name in "xywh")
    # In all files of JRDB, at most 7 % of the boxes could be corners, and no box ends below the picture.
    corners = _most((w > x) & (h > y))
    form = ""
    if _most((w <= 1) & (h <= 1), 0.05) or _most((x <= 100) & (w <= 100) & (y <= 100) & (h <= 100)):
        form = f"fractions or per cents of the picture ({'x1, y1, x2, y2' if corners else 'x, y, width, height'})"
    elif _most((w > x) & (h > y) & (w > WIDTH / 20), 0.15):
        form = "corners (x1, y1, x2, y2)"
    elif _most(y + h > 1.05 * HEIGHT, 0.02):
        form = "centres (x, y, width, height), or like pixels of another picture"
    return [f"2D boxes look like {form}, not like left, top, width, height in pixels: convert them"] if form else []


def _most(mask: Bools, share: float = 0.5) -> bool:
    return bool(len(mask)) and float(mask.mean()) > share


def sketch_boxes(boxes: pa.Table) -> frozenset[int]:
    """Return the smallest hashes of the boxes. Two sequences with the same boxes share them, whatever their frames.

    Args:
        boxes: annotation table `boxes_2d`.

    Returns:
        At most 256 hashes of different boxes.
    """
    numbers = np.stack([boxes[name].to_numpy() for name in "xywh"], axis=1).view(np.uint64)
    return frozenset(np.unique((numbers * _FACTORS).sum(axis=1, dtype=np.uint64))[:256].tolist())


def _box_table(
    columns: Columns, codes: dict[str, Distinct], people: KeptRecords, listed: Bools, refusals: Refusals
) -> pa.Table:
    box, code = columns["box"], columns["attributes"]
    attributes_of = [item or Attributes2D() for item in codes["attributes"]]

    def attribute(name: str, read: Callable[[Any], Any] | None, kind: pa.DataType) -> pa.Array:
        return _taken([getattr(item, name) for item in attributes_of], code, kind, refusals, f"attributes.{name}", read)

    return pa.table(
        {
            "frame": people.frame,
            "track": people.track,
            **{name: box[:, i] for i, name in enumerate("xywh")},
            "has_attributes": _taken([item is not None for item in codes["attributes"]], code, pa.bool_(), refusals),
            "occlusion": attribute("occlusion", _occlusion, pa.string()),
            "truncated": attribute("truncated", records.read_flag, pa.bool_()),
            "interpolated": attribute("interpolated", None, pa.bool_()),
            "no_eval": attribute("no_eval", None, pa.bool_()),
            "has_actions": listed,
            "file_id": _taken(
                list(codes["file_id"]), columns["file_id"], pa.string(), refusals, "file_id", records.read_text
            ),
        }
    )


def _taken(
    values: list[Any],
    code: Ints,
    kind: pa.DataType,
    refusals: Refusals,
    field: str = "",
    read: Callable[[Any], Any] | None = None,
) -> pa.Array:
    """Return an Arrow column of the type `kind`. Row i of the column is made from the value `values[code[i]]`.

    If the argument `read` is a function, the row holds the result of `read(value)`. If the function raises ValueError,
    the row is null and is counted as a refused field. If `read` is None, the row holds the value itself. A row with
    the value None is always null.
    """
    usable: list[Any] = []
    wrong: dict[int, str] = {}
    for i, value in enumerate(values):
        try:
            usable.append(value if value is None or read is None else read(value))
        except ValueError as error:
            usable.append(None)
            wrong[i] = str(error)
    refused = np.isin(code, list(wrong))
    refusals.count(refused, "field", next(iter(wrong.values()), ""), field, lambda row: values[code[row]])
    return spread(usable, kind, code)


def _occlusion(value: str) -> str:
    if value not in OCCLUSIONS:
        raise ValueError("not a known degree of occlusion")
    return value


# -- raw sub-objects -----------------------------------------------------------------------------------------------


def _actions(raw: bytes, decoded: Decoded) -> None:
    for label, code in decoded.labels(raw, "action_label"):
        action = normal_action(label)
        decoded.whole &= action in ACTIONS
        if action != IMPOSSIBLE:
            decoded.values.append((action, label, decoded.difficulty(code, "action_label")))


def _activities(raw: bytes, decoded: Decoded) -> None:
    for label, value in decoded.labels(raw, "social_activity"):
        confidence = decoded.read(records.read_number, value, "social_activity", "value: ")
        decoded.values.append((normal_action(label), confidence))


def _group(raw: bytes, decoded: Decoded) -> None:
    values = decoded.members(raw, "social_group")
    if not decoded.whole:
        return
    cluster = decoded.read(_cluster, values.get("cluster_ID"), "social_group.cluster_ID")
    if cluster is not None:
        code = decoded.read(records.read_difficulty, values.get("cluster_stat"), "social_group.cluster_stat")
        decoded.values.append((cluster, code))


def _cluster(value: object) -> int:
    return records.read_whole(value, -(2**62), 2**62)
