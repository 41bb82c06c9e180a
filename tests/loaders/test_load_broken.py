"""Broken input: every kind is refused or skipped alone, counted with file, frame and field; the rest loads.

Each case is one record or file put beside good ones. Nothing gives a traceback, nothing becomes a wrong fact.
"""

from __future__ import annotations

import json
import os
import time

import msgspec
import pyarrow.compute as pc
import pytest
from quick_store import NAME, read_store, without_graph
from worlds import load_reported, person, person_3d, write_root

from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.engine.rederive.truth import TRUE, UNKNOWN
from jrdb_avr.loaders.labelfiles import frames as labelfile
from jrdb_avr.loaders.labelfiles.record_reader import MAX_RECORDS, RecordReader
from jrdb_avr.loaders.layers.boxes_2d import Record2D, load_2d
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, InputError
from jrdb_avr.schema.rules import Rules

READER = RecordReader(Record2D, {}, once=())
GOOD = person(1, (100, 60, 50, 200), {"walking": 1}, (5, 1))


def raw_2d(*records, frame="000015.jpg"):
    """A 2D file with a good frame 0 and the given raw records in another frame."""
    return f'{{"labels": {{"000000.jpg": [{json.dumps(GOOD)}], "{frame}": [{", ".join(records)}]}}}}'


def loaded(tmp_path, content, layer="2d"):
    """What is read of one file (beside good 2D labels, where it is 3D): a store, and the readers' findings."""
    layers = {layer: content} if layer == "2d" else {"2d": {0: [GOOD], 15: [GOOD]}, layer: content}
    return read_store(tmp_path, layers)


@pytest.fixture
def graphless():
    """For loads whose reports and tables alone are looked at."""
    with without_graph():
        yield


def boxes(store, layer="boxes_2d"):
    return [(row["frame"], row["track"]) for row in store.annotation(layer, NAME).to_pylist()]


def problems_of(report):
    return [(p.kind, p.reason, p.count, p.file, p.frame, p.field) for p in report.problems]


def variant(**changes):
    record = GOOD | {"label_id": "pedestrian:2"} | changes
    return json.dumps({key: value for key, value in record.items() if value is not ...})


BAD_BOXES = {
    "NaN": [float("nan"), 1, 5, 5],
    "infinite": [1, 1, float("inf"), 5],
    "minus infinite": [float("-inf"), 1, 5, 5],
    "too large": [1, 1, 10**400, 5],
    "far outside": [1e9, 1, 5, 5],
    "zero width": [1, 1, 0, 5],
    "negative height": [1, 1, 5, -5],
    "three numbers": [1, 1, 5],
    "five numbers": [1, 1, 5, 5, 5],
    "texts": ["1", "1", "5", "5"],
    "bools": [True, 1, 5, 5],
    "an object": {"x": 1},
    "null": None,
    "missing": ...,
    "nested": [[[]], 1, 5, 5],
}


@pytest.mark.parametrize("box", BAD_BOXES.values(), ids=BAD_BOXES)
def test_a_bad_box_costs_its_own_record(tmp_path, box):
    store, found = loaded(tmp_path, raw_2d(variant(box=box), json.dumps(GOOD)))
    assert boxes(store) == [(0, 1), (15, 1)]
    ((kind, reason, count, file, frame, field),) = problems_of(found)
    assert (kind, count, file, frame, field) == ("record", 1, f"{NAME}.json", "000015.jpg", "box")
    assert reason.startswith("box")
    # Somebody was there whom we could not place: the frame proves nobody's absence and nothing unique.
    frames = {row["frame"]: row["annotated"] for row in store.interval("frames", NAME).to_pylist()}
    assert frames == {0: True, 15: False}
    assert store.interval("sequence", NAME)["keyframes"].to_pylist() == [[0]]


BAD_IDS = {
    "missing": ...,
    "null": None,
    "a number": 7,
    "no number": "pedestrian:",
    "negative": "pedestrian:-1",
    "huge": "pedestrian:99999999999999999999",
    "beyond 32 bits": "pedestrian:2147483648",
    "a fraction": "pedestrian:1.5",
    "other digits": "pedestrian:٣",
    "a list": ["pedestrian:1"],
    "lone surrogate": "pedestrian:\ud800",
}


@pytest.mark.parametrize("label", BAD_IDS.values(), ids=BAD_IDS)
def test_a_bad_label_id_costs_its_own_record(tmp_path, label):
    store, found = loaded(tmp_path, raw_2d(variant(label_id=label), json.dumps(GOOD)))
    assert boxes(store) == [(0, 1), (15, 1)]
    ((kind, _, count, _, frame, field),) = problems_of(found)
    assert (kind, count, frame, field) == ("record", 1, "000015.jpg", "label_id")


def test_things_are_skipped_and_the_frame_stays_whole(tmp_path):
    others = [variant(label_id=label) for label in ("car:-1", "Chair/Sofa:3", "sofa:7", "big_vehicle:2")]
    store, found = loaded(tmp_path, raw_2d(*others, json.dumps(GOOD)))
    assert boxes(store) == [(0, 1), (15, 1)]
    assert [(p.reason, p.count, p.detail) for p in found.problems] == [("label_id is of a thing", 4, "car:-1")]
    assert store.interval("frames", NAME)["annotated"].to_pylist() == [True, True]


@pytest.mark.parametrize(
    "label", ["Pedestrian:1", "pedestrian:-1", "ped:1", "person:-1", "robot:3", "child:2", "other:3"]
)
def test_whoever_may_be_a_person_proves_nobodys_absence(tmp_path, label):
    store, found = loaded(tmp_path, raw_2d(variant(label_id=label), json.dumps(GOOD)))
    assert boxes(store) == [(0, 1), (15, 1)]
    assert [(p.reason, p.count, p.detail) for p in found.problems] == [("label_id is not pedestrian:N", 1, label)]
    assert store.interval("frames", NAME)["annotated"].to_pylist() == [True, False]


def test_id_zero_is_a_person(tmp_path):
    store, found = loaded(tmp_path, {0: [person(0, (1, 60, 50, 200), {"sitting": 1}, (0, 1))]})
    assert boxes(store) == [(0, 0)]
    assert found.problems == []
    assert store.interval("actions", NAME)["track"].to_pylist() == [0]


def test_the_first_of_a_repeated_person_is_kept(tmp_path):
    store, found = loaded(tmp_path, raw_2d(variant(box=[1, 2, 3, 4]), variant(box=[5, 6, 7, 8])))
    assert [tuple(row[k] for k in "xywh") for row in store.annotation("boxes_2d", NAME).to_pylist()][1] == (1, 2, 3, 4)
    assert problems_of(found) == [
        ("record", "same person twice in a frame", 1, f"{NAME}.json", "000015.jpg", "label_id")
    ]


@pytest.mark.parametrize("record", ["3", "null", '"pedestrian:1"', "[]", "[[1]]", "true", "NaN"])
def test_a_record_that_is_no_object_is_refused(tmp_path, record):
    store, found = loaded(tmp_path, raw_2d(record, json.dumps(GOOD)))
    assert boxes(store) == [(0, 1), (15, 1)]
    assert [(p.kind, p.reason, p.frame) for p in found.problems] == [("record", "record is no object", "000015.jpg")]


@pytest.mark.parametrize("value", ["3", "null", '"x"', "{}", "NaN", "true"])
def test_a_frame_that_is_no_list_is_refused_and_not_known(tmp_path, value):
    text = f'{{"labels": {{"000000.jpg": [{json.dumps(GOOD)}], "000015.jpg": {value}}}}}'
    store, found = loaded(tmp_path, text)
    assert store.interval("frames", NAME)["frame"].to_pylist() == [0]
    assert [(p.kind, p.frame) for p in found.problems] == [("frame", "000015.jpg")]


@pytest.mark.parametrize(
    "key", ["15.jpg", "000015", "000015.pcd", "-00015.jpg", "0000015.jpg", "x.jpg", "", "٠٠٠٠١٥.jpg"]
)
def test_a_bad_frame_key_is_refused(tmp_path, key):
    store, found = loaded(tmp_path, {0: [GOOD], key: [GOOD]})
    assert boxes(store) == [(0, 1)]
    assert [(p.kind, p.frame) for p in found.problems] == [("frame", key)]


def test_the_first_of_a_repeated_frame_key_is_kept(tmp_path):
    again = f'{{"labels": {{"000000.jpg": [{json.dumps(GOOD)}], "000000.jpg": [{variant()}]}}}}'
    store, found = loaded(tmp_path, again)
    assert boxes(store) == [(0, 1)]
    assert [(p.kind, p.reason) for p in found.problems] == [("frame", "frame key twice, the first is kept")]


@pytest.mark.parametrize("frames", range(1, 20))
@pytest.mark.parametrize("colon", [":", ": ", " : "])
@pytest.mark.parametrize("again", ["000000.jpg", "000000\\u002ejpg"])
def test_a_repeated_frame_key_is_found_whatever_the_layout(tmp_path, frames, colon, again):
    members = [f'"{i:06d}.jpg"{colon}[]' for i in range(1, frames)]
    text = f'{{"labels":{{"000000.jpg"{colon}[{json.dumps(GOOD)}],{",".join([*members, ""])}"{again}"{colon}[]}}}}'
    problems = Problems("x.json")
    (tmp_path / "x.json").write_text(text)
    read = [
        frame for batch, _ in labelfile.read_frames(tmp_path / "x.json", ("jpg",), READER, problems) for frame in batch
    ]
    assert [frame.number for frame in read] == list(range(frames))
    assert json.loads(read[0].raw) == [GOOD]
    assert [(p.kind, p.reason, p.frame) for p in problems.listed()] == [
        ("frame", "frame key twice, the first is kept", "000000.jpg")
    ]


def test_a_second_labels_object_is_counted(tmp_path):
    text = f'{{"labels": {{"000000.jpg": [{json.dumps(GOOD)}]}}, "labels": {{"000015.jpg": []}}}}'
    store, found = loaded(tmp_path, text)
    assert boxes(store) == [(0, 1)]
    assert [(p.kind, p.reason, p.field) for p in found.problems] == [("file", "key twice, the first is kept", "labels")]


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    store, found = loaded(tmp_path, b"\xef\xbb\xbf" + json.dumps({"labels": {"000000.jpg": [GOOD]}}).encode())
    assert (boxes(store), found.problems) == ([(0, 1)], [])


@pytest.mark.parametrize("labels", ['{"sitting":1,"sitting" :3}', '{"sitting" :1,"sitting" :3}'])
def test_a_repeated_label_is_found_whatever_the_layout(tmp_path, labels):
    record = f'{{"label_id": "pedestrian:2", "box": [1, 2, 3, 4], "action_label": {labels}}}'
    store, found = loaded(tmp_path, raw_2d(record))
    assert store.annotation("actions", NAME)["difficulty"].to_pylist() == [1, 1]
    assert [(p.reason, p.field) for p in found.problems] == [("key twice, the first is kept", "action_label.sitting")]


def test_an_empty_list_means_nobody_is_here(tmp_path):
    store, found = loaded(tmp_path, {0: [GOOD], 15: []})
    assert found.problems == []
    assert store.interval("frames", NAME)["annotated"].to_pylist() == [True, True]


def test_a_repeated_key_in_a_record_is_counted_and_the_first_holds(tmp_path):
    actions = '"action_label": {"sitting": 1, "sitting": 3}'
    record = f'{{"label_id": "pedestrian:2", "box": [1, 2, 3, 4], "box": [5, 6, 7, 8], {actions}}}'
    store, found = loaded(tmp_path, raw_2d(record))
    assert store.annotation("boxes_2d", NAME)["x"].to_pylist() == [100, 1]
    assert store.annotation("actions", NAME)["difficulty"].to_pylist() == [1, 1]
    assert [(p.reason, p.field) for p in found.problems] == [
        ("key twice, the first is kept", "action_label.sitting"),
        ("key twice, the first is kept", "box"),
    ]


# -- fields: the record stays, the field is lost ---------------------------------------------------------------


@pytest.mark.parametrize(("code", "stored"), [(1, 1), (1.0, 1), ("1", 1), (2, 2), ("3", 3), (3.0, 3)])
def test_difficulty_may_be_a_number_or_text(tmp_path, code, stored):
    store, found = loaded(tmp_path, raw_2d(variant(action_label={"sitting": code})))
    assert store.annotation("actions", NAME)["difficulty"].to_pylist()[1] == stored
    assert found.problems == []


@pytest.mark.parametrize("code", [0, 4, -1, 1.5, "x", "", None, [1], {}, True, float("nan"), 10**30, "1.0.0"])
def test_an_unreadable_difficulty_makes_the_action_unknown(tmp_path, code):
    store, found = loaded(tmp_path, raw_2d(variant(action_label={"sitting": code})))
    actions = store.annotation("actions", NAME).to_pylist()
    assert [(row["action"], row["difficulty"]) for row in actions] == [("walking", 1), ("sitting", None)]
    (problem,) = found.problems
    assert (problem.kind, problem.field, problem.frame) == ("field", "action_label", "000015.jpg")
    sitting = [row for row in store.interval("actions", NAME).to_pylist() if row["action"] == "sitting"]
    assert [row["certain"] for row in sitting] == [False]
    assert store.interval("sightings", NAME)["pose"].to_pylist() == ["walking", None]


@pytest.mark.parametrize("label", ["impossible", "waiting for sth"])
def test_a_list_with_a_label_that_may_be_any_tells_only_what_it_names(tmp_path, label):
    record = variant(action_label={"sitting": 1, "reading": 1, label: 1})
    store, _ = loaded(tmp_path, raw_2d(record))
    assert store.interval("sightings", NAME)["listed"].to_pylist() == [True, False]
    facts = Annotations.read(store, NAME, Rules())
    told = {action: facts.state(2, action, 15) for action in ("reading", "typing", "sitting", "walking")}
    assert told == {"reading": TRUE, "typing": UNKNOWN, "sitting": UNKNOWN, "walking": UNKNOWN}
    assert store.interval("sightings", NAME)["pose"].to_pylist() == ["walking", None]


@pytest.mark.parametrize("value", [[], "walking", 3, ["walking"], True])
def test_an_action_label_of_another_type_is_refused(tmp_path, value):
    store, found = loaded(tmp_path, raw_2d(variant(action_label=value)))
    assert store.annotation("boxes_2d", NAME)["has_actions"].to_pylist() == [True, False]
    assert [(p.kind, p.field) for p in found.problems] == [("field", "action_label")]


@pytest.mark.parametrize("value", [{}, None, ..., {"impossible": 1}])
def test_no_usable_actions_is_no_list_and_no_problem(tmp_path, value):
    store, found = loaded(tmp_path, raw_2d(variant(action_label=value)))
    assert store.annotation("boxes_2d", NAME)["has_actions"].to_pylist() == [True, False]
    assert found.problems == []


def test_labels_outside_the_vocabulary_are_kept_and_reported(tmp_path):
    store, found = loaded(tmp_path, raw_2d(variant(action_label={"Juggling_Balls": 1, "Opening-the-door": 2})))
    names = store.annotation("actions", NAME).to_pylist()[1:]
    assert [(row["action"], row["raw"]) for row in names] == [
        ("interaction with door", "Opening-the-door"),
        ("juggling balls", "Juggling_Balls"),
    ]
    assert [(u.field, u.label, u.count) for u in found.unknown] == [("action_label", "juggling balls", 1)]


@pytest.mark.parametrize("name", ["", " ", "\u0000", "\ud800", "x" * 101, "\x1b"])
def test_a_label_that_is_no_text_is_refused(tmp_path, name):
    store, found = loaded(tmp_path, raw_2d(variant(action_label={name: 1, "sitting": 1})))
    assert store.annotation("actions", NAME)["action"].to_pylist() == ["walking", "sitting"]
    assert [(p.kind, p.field) for p in found.problems] == [("field", "action_label")]


@pytest.mark.parametrize(
    ("value", "stored"), [("true", True), ("False", False), (True, True), (None, None), (..., None)]
)
def test_truncated_in_its_spellings(tmp_path, value, stored):
    attributes = {k: v for k, v in {"occlusion": "Fully_visible", "truncated": value}.items() if v is not ...}
    store, found = loaded(tmp_path, raw_2d(variant(attributes=attributes)))
    assert store.annotation("boxes_2d", NAME)["truncated"].to_pylist()[1] is stored
    assert found.problems == []


BAD_ATTRIBUTES = [
    ("occlusion", "Nearly_visible"),
    ("occlusion", 3),
    ("truncated", "yes"),
    ("truncated", 7),
    ("no_eval", 2),
    ("no_eval", "maybe"),
    ("interpolated", [True]),
]


@pytest.mark.parametrize(("name", "value"), BAD_ATTRIBUTES)
def test_a_bad_attribute_is_unknown(tmp_path, name, value):
    store, found = loaded(tmp_path, raw_2d(variant(attributes={"occlusion": "Fully_visible"} | {name: value})))
    assert store.annotation("boxes_2d", NAME)[name].to_pylist()[1] is None
    (problem,) = found.problems
    assert (problem.kind, problem.field, problem.frame) == ("field", f"attributes.{name}", "000015.jpg")


def test_who_cannot_be_told_to_be_evaluated_is_in_no_clear_view(tmp_path):
    bad = {"occlusion": "Fully_visible", "no_eval": "maybe"}
    store, _ = loaded(tmp_path, raw_2d(variant(attributes=bad)))
    assert store.interval("sightings", NAME)["clear"].to_pylist() == [True, False]


def test_attributes_that_cannot_be_read_are_still_attributes(tmp_path):
    """Where nobody has any, everybody counts as visible."""
    store, found = loaded(tmp_path, {0: [person(1, (1, 60, 50, 200)) | {"attributes": [1]}]})
    assert store.interval("sequence", NAME)["has_attributes"].to_pylist() == [True]
    assert store.interval("sightings", NAME)["clear"].to_pylist() == [False]
    assert [problem.field for problem in found.problems] == ["attributes"]


def test_missing_occlusion_is_not_visible(tmp_path):
    store, found = loaded(tmp_path, raw_2d(variant(attributes={"no_eval": False})))
    assert store.interval("sightings", NAME)["clear"].to_pylist() == [True, False]
    assert found.problems == []


def test_a_world_without_attributes_is_clear(tmp_path):
    store, _ = loaded(tmp_path, {0: [person(1, (1, 60, 50, 200), attributes=None)]})
    assert store.interval("sightings", NAME)["clear"].to_pylist() == [True]
    assert store.interval("sequence", NAME)["has_attributes"].to_pylist() == [False]


@pytest.mark.parametrize("value", [[], 5, {"cluster_ID": "x"}, {"cluster_ID": 1.5}, {}, {"cluster_ID": 10**30}, "a"])
def test_a_bad_group_is_no_group(tmp_path, value):
    store, found = loaded(tmp_path, raw_2d(variant(social_group=value)))
    assert store.annotation("groups", NAME)["track"].to_pylist() == [1]
    ((kind, field),) = [(p.kind, p.field.partition(".")[0]) for p in found.problems]
    assert (kind, field) == ("field", "social_group")


def test_time_is_not_squared_where_every_record_is_wrong_in_its_own_way(tmp_path):
    def crowd(frame):
        named = [(i, f"label {frame} {i}") for i in range(500)]
        return [person(i, (1, 2, 30, 40), {name: 1, "sitting": name}, (name, 1)) for i, name in named]

    def seconds(frames):
        """Of processor time, and the problems."""
        path = write_root(tmp_path, {NAME: {"2d": {frame: crowd(frame) for frame in range(frames)}}})
        problems = Problems("x.json")
        started = time.process_time()
        load_2d(path / "labels" / "labels_2d_stitched" / f"{NAME}.json", problems)
        return time.process_time() - started, problems.listed()

    few = min(seconds(1)[0] for _ in range(3))
    many, problems = seconds(16)
    assert many < 16 * 3 * few
    assert {(p.reason, p.field): (p.count, p.frame, p.detail) for p in problems} == {
        ("difficulty: not a number", "action_label"): (8_000, "000000.jpg", "label 0 0"),
        ("not a number", "social_group.cluster_ID"): (8_000, "000000.jpg", "label 0 0"),
    }


# -- 3D --------------------------------------------------------------------------------------------------------


def with_3d(**changes):
    record = person_3d(2, 1.0, 2.0)
    box = {key: value for key, value in (record["box"] | changes).items() if value is not ...}
    return {0: [person_3d(1, 3.0, 0.0), record | {"box": box}]}


@pytest.mark.parametrize(
    "changes",
    [
        {"cx": float("nan")},
        {"cy": float("inf")},
        {"rot_z": None},
        {"h": 0},
        {"l": -1},
        {"cz": "1"},
        {"w": ...},
        {"cx": 1e9},
    ],
)
def test_a_bad_3d_box_costs_its_frame(tmp_path, changes):
    store, found = loaded(tmp_path, with_3d(**changes) | {15: [person_3d(1, 3.0, 0.0)]}, "3d")
    assert boxes(store, "boxes_3d") == [(15, 1)]
    ((kind, _, count, _, frame, field),) = problems_of(found)
    assert (kind, count, frame, field) == ("record", 1, "000000.pcd", "box")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("distance", "x"),
        ("distance", -1),
        ("distance", float("nan")),
        ("num_points", -1),
        ("num_points", 1.5),
        ("num_points", 10**400),
        ("no_eval", 3),
    ],
)
def test_a_bad_3d_attribute_is_unknown(tmp_path, name, value):
    record = person_3d(1, 3.0, 4.0)
    record["attributes"][name] = value
    store, found = loaded(tmp_path, {0: [record]}, "3d")
    assert store.annotation("boxes_3d", NAME)[name].to_pylist() == [None]
    assert [(p.kind, p.field) for p in found.problems] == [("field", f"attributes.{name}")]
    assert store.interval("sightings", NAME)["distance"].to_pylist()[0] == (None if name == "num_points" else 5.0)


def test_missing_distance_is_computed(tmp_path):
    store, found = loaded(tmp_path, {0: [person_3d(1, 3.0, 4.0, distance=None)]}, "3d")
    assert store.interval("sightings", NAME)["distance"].to_pylist() == [5.0, None]
    assert found.problems == []


def test_the_heading_check_sees_a_reversed_convention(tmp_path):
    walks = {f: [person_3d(1, 3.0 + f * 0.1, 0.0, heading=0.0)] for f in range(0, 60)}
    _, found = loaded(tmp_path / "right", walks, "3d")
    assert (found.heading.moves, round(found.heading.median_deg)) == (45, 0)
    backwards = {f: [person_3d(1, 3.0 + f * 0.1, 0.0, heading=3.14159265)] for f in range(0, 60)}
    _, found = loaded(tmp_path / "wrong", backwards, "3d")
    assert round(found.heading.median_deg) == 180


# -- files -----------------------------------------------------------------------------------------------------

WHOLE = json.dumps({"labels": {"000000.jpg": [GOOD], "000015.jpg": [GOOD]}})
BAD_FILES = {
    "empty": b"",
    "blank": b" \n\t ",
    "truncated": WHOLE[: len(WHOLE) // 2].encode(),
    "truncated in a text": WHOLE[: WHOLE.index("walk") + 2].encode(),
    "two texts": (WHOLE + WHOLE).encode(),
    "a bracket too many": (WHOLE + "}").encode(),
    "last bracket missing": WHOLE[:-1].encode(),
    "not UTF-8": WHOLE.encode().replace(b"walking", b"walk\xff\xfeg"),
    "UTF-16": WHOLE.encode("utf-16"),
    "a list": b"[1, 2]",
    "a number": b"7",
    "a text": b'"labels"',
    "no labels": b'{"detections": {}}',
    "labels are a list": b'{"labels": []}',
    "labels are null": b'{"labels": null}',
    "no frames": b'{"labels": {}}',
    "not JSON": b"label_id,box\n1,2\n",
    "a picture": b"\xff\xd8\xff\xe0" + bytes(range(256)),
    "zeros": bytes(1000),
    "nested deeply": b"[" * 200_000,
    "labels nested deeply": b'{"labels": ' + b'{"a":' * 100_000,
    "only bad frames": b'{"labels": {"x": [], "y": []}}',
}


@pytest.mark.parametrize("content", BAD_FILES.values(), ids=BAD_FILES)
def test_a_bad_file_is_refused_as_a_whole(tmp_path, content):
    store, found = loaded(tmp_path, content)
    assert not found.frames and boxes(store) == []
    if content not in (BAD_FILES["no frames"], BAD_FILES["only bad frames"]):
        (problem,) = found.problems
        assert (problem.kind, problem.file, problem.count) == ("file", f"{NAME}.json", 1)
        assert problem.reason.startswith(NAME) and "\n" not in problem.reason


@pytest.mark.parametrize("layer", ["3d", "social", "reasoning", "pose", "panoptic", "timestamps", "calibration"])
@pytest.mark.parametrize("name", ["empty", "truncated", "not UTF-8", "a list", "zeros", "nested deeply", "a picture"])
def test_a_bad_file_of_another_layer_costs_that_layer_alone(tmp_path, layer, name):
    content = {"images": BAD_FILES[name]} if layer == "timestamps" else BAD_FILES[name]
    store, found = read_store(tmp_path, {"2d": {0: [GOOD]}, layer: content})
    assert list(found.frames) == ["2d", "actions", "groups", "images"]
    assert boxes(store) == [(0, 1)]
    (problem,) = found.problems
    assert (problem.kind, problem.count) == ("file", 1)
    assert problem.file and "\n" not in problem.reason


@pytest.mark.parametrize("text", ['"frame_id": 01', '"frame_id": 1, "timestamp": 01549500000.0'])
def test_a_stamp_that_is_no_json_number_is_refused(tmp_path, text):
    """Numbers with a leading zero were once read as if they stood in quotes."""
    entry = f'{{{text}, "timestamp": 1549500000.0}}' if "timestamp" not in text else f"{{{text}}}"
    stamps = f'{{"data": [{{"frame_id": 0, "timestamp": 1549500000.0}}, {entry}]}}'
    world = {"2d": {0: [GOOD]}, "timestamps": {"images": stamps}}
    store, found = read_store(tmp_path, world)
    assert store.annotation("timestamps", NAME)["frame"].to_pylist() == [0]
    assert [(p.kind, p.count) for p in found.problems] == [("record", 1)]


def test_the_good_files_beside_bad_ones_load(tmp_path, graphless):
    world = {f"bad-{i}": {"2d": content} for i, content in enumerate(BAD_FILES.values())}
    store, reports = load_reported(tmp_path, world | {"good-1": {"2d": {0: [GOOD]}}})
    assert list(store.manifest().sequences) == ["good-1"]
    assert [report.sequence for report in reports] == sorted([*world, "good-1"])
    assert [path.stem for path in (store.path / "intervals" / "sightings").iterdir()] == ["good-1"]


def test_a_deeply_nested_record_costs_itself(tmp_path):
    deep = '{"label_id": "pedestrian:2", "box": [1, 2, 3, 4], "action_label": ' + "[" * 5000 + "]" * 5000 + "}"
    store, found = loaded(tmp_path, raw_2d(deep, json.dumps(GOOD)))
    assert (15, 1) in boxes(store)
    assert found.problems


def test_what_is_no_file_is_refused(tmp_path, graphless):
    world = {"good-1": {"2d": {0: [GOOD]}}}
    folder = write_root(tmp_path / "root", world) / "labels" / "labels_2d_stitched"
    (folder / "folder-1.json").mkdir()
    (folder / "loop-1.json").symlink_to(folder / "loop-1.json")
    (folder / "gone-1.json").symlink_to(folder / "nothing")
    os.mkfifo(folder / "pipe-1.json")
    (folder / "bad name!.json").write_text("{}")
    (folder / "notes.txt").write_text("x")
    store, reports = load_reported(tmp_path, world)
    assert list(store.manifest().sequences) == ["good-1"]
    refused = {problem.file for report in reports for problem in report.problems}
    assert refused == {"folder-1.json", "loop-1.json", "gone-1.json", "pipe-1.json", "bad name!.json"}


def test_images_that_cannot_be_read_are_no_images(tmp_path, monkeypatch, graphless):
    world = {"good-1": {"2d": {0: [GOOD]}, "images": [0]}, "good-2": {"2d": {0: [GOOD]}, "images": [0]}}
    images = write_root(tmp_path / "root", world) / "images" / "image_stitched"
    (images / "good-1" / "000001.jpg").symlink_to("000001.jpg")
    os.mkfifo(images / "good-1" / "000002.jpg")
    scandir = os.scandir

    def refusing(folder):
        if str(folder).endswith("good-2"):
            raise PermissionError(13, "Permission denied")
        return scandir(folder)

    monkeypatch.setattr(os, "scandir", refusing)
    store, reports = load_reported(tmp_path, world)
    pictures = {name: store.interval("frames", name).filter(pc.field("image"))["frame"].to_pylist() for name in world}
    assert pictures == {"good-1": [0], "good-2": []}
    assert [problems_of(report) for report in reports] == [
        [],
        [("file", "good-2: the folder of images cannot be read: Permission denied", 1, "good-2", "", "")],
    ]


def test_a_file_name_that_is_no_unicode_can_be_reported(tmp_path, graphless):
    world = {"good-1": {"2d": {0: [GOOD]}}}
    folder = write_root(tmp_path / "root", world) / "labels" / "labels_2d_stitched"
    (folder / os.fsdecode(b"bad\xff.json")).write_text("{}")
    _, reports = load_reported(tmp_path, world)
    assert [problem["file"] for report in reports for problem in msgspec.to_builtins(report)["problems"]] == [
        "bad .json"
    ]
    assert json.loads(msgspec.json.encode(reports))


@pytest.mark.parametrize("text", [WHOLE + " " * 1000, WHOLE + "x" * 1000])
def test_a_file_over_the_limit_is_refused(tmp_path, monkeypatch, text, graphless):
    monkeypatch.setattr(labelfile, "MAX_FILE", 1000)
    world = {NAME: {"2d": text}, "good-1": {"2d": {0: [GOOD]}}}
    _, reports = load_reported(tmp_path, world)
    assert "larger than the limit" in reports[1].problems[0].reason


SHORT = '{"labels": {"000000.jpg": [], "000001.jpg": [{"a": [1, 2]}]}}'
PAD = " " * 7
USUAL = (
    SHORT,
    SHORT.replace("1, 2", '"000009.jpg: [", "]},", "\u00e9"'),
    "\ufeff" + SHORT.replace(":", f"{PAD}:{PAD}").replace(",", f"\n,{PAD}") + "\n",
    SHORT.replace("}]}}", f"}}]{PAD}}}{PAD}}}{PAD}"),
    SHORT.replace("[],", '[], "000000.jpg": [],'),
    SHORT.replace("[],", '[3, "\\"000001.jpg\\": []"], "000000.jpg": [],'),
)
ODD = (
    '{"labels": {}}',
    *(SHORT[:end] for end in range(1, len(SHORT))),
    SHORT.replace("1, 2", "NaN"),
    SHORT.replace("[],", "[] [],"),
    SHORT.replace("[],", "[]"),
    SHORT.replace("[],", '[], "notes": [],'),
    SHORT.replace("[],", '[], "00000a.jpg": [],'),
    SHORT.replace("[],", '[], "00000\\u0030.jpg": [1],'),
    SHORT.replace("[],", "[},"),
    SHORT + "}",
    SHORT[:-1] + ', "labels": {}}',
    SHORT.replace('"labels"', '"notes": 1, "labels"'),
    SHORT.replace('{"labels"', '["labels"'),
)


def frames_of(folder, text):
    """Frames and problems of a text; the problem alone where it is refused."""
    (folder / "x.json").write_text(text)
    problems = Problems("x.json")
    try:
        read = labelfile.read_frames(folder / "x.json", ("jpg",), READER, problems)
        return [frame for batch, _ in read for frame in batch], problems.listed()
    except InputError as error:
        return str(error)


@pytest.mark.parametrize("text", [*USUAL, *ODD])
def test_the_scanner_and_the_decoder_cut_files_alike(tmp_path, monkeypatch, text):
    found = frames_of(tmp_path, text)
    scanned = []
    members = labelfile.members
    monkeypatch.setattr(labelfile, "members", lambda data: scanned.append(data) or members(data))
    frames_of(tmp_path, text)
    assert bool(scanned) == (text in ODD)
    monkeypatch.setattr(labelfile, "_usual_texts", lambda path: [])
    assert frames_of(tmp_path, text) == found


@pytest.mark.parametrize("batch", [1, 300, 1 << 20])
@pytest.mark.parametrize("window", range(60, 90))
def test_a_key_is_found_wherever_a_window_of_the_file_ends(tmp_path, monkeypatch, window, batch):
    frames = {f"{i:06d}.jpg": [GOOD] * (i % 3) for i in range(12)}
    text = json.dumps({"labels": frames})
    monkeypatch.setattr(labelfile, "_WINDOW", window)
    monkeypatch.setattr(labelfile, "scanned_sections", None)
    monkeypatch.setattr(labelfile, "BATCH_BYTES", batch)
    found, problems = frames_of(tmp_path, text)
    read = {frame.key: [record.label_id for record in frame.records] for frame in found}
    assert (read, problems) == ({key: [GOOD["label_id"]] * len(found) for key, found in frames.items()}, [])


@pytest.mark.parametrize("width", range(64))
def test_an_end_that_is_seen_in_a_window_alone_is_no_end(tmp_path, monkeypatch, width):
    monkeypatch.setattr(labelfile, "_WINDOW", 64)
    monkeypatch.setattr(labelfile, "_MAX_FRAME", 500)
    last = json.dumps({"labels": {"000000.jpg": [GOOD], "000015.jpg": "x" * (560 + 2 * width)}})
    assert frames_of(tmp_path, last + " more") == "x.json: not JSON: there is text after its end"
    found, problems = frames_of(tmp_path, last)
    assert ([frame.number for frame in found], [problem.frame for problem in problems]) == ([0], ["000015.jpg"])


def test_a_record_with_a_key_that_is_no_text_is_no_object(tmp_path):
    for key in ('"n\\x"', '"n\t"'):
        store, found = loaded(tmp_path, raw_2d(json.dumps(GOOD)[:-1] + f", {key}: 1}}"))
        assert boxes(store) == [(0, 1)]
        assert [p.reason for p in found.problems] == ["record is no object"]


def test_the_first_byte_that_is_not_utf_8_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(labelfile, "_PIECE", 4)
    for place in range(12):
        data = ("\u00e9" * 20).encode()
        data = data[:place] + b"\xff" + data[place:]
        (tmp_path / "x.json").write_bytes(data)
        with pytest.raises(UnicodeDecodeError) as true:
            data.decode()
        with pytest.raises(InputError, match=f"byte {true.value.start}$"):
            labelfile.read_file(tmp_path / "x.json")


def test_frames_too_full_to_be_real_are_refused(tmp_path):
    crowd = [person(i, (1, 2, 30, 40)) for i in range(MAX_RECORDS + 1)]
    store, found = loaded(tmp_path, {0: [GOOD], 15: crowd})
    assert boxes(store) == [(0, 1)]
    assert [(p.kind, p.frame) for p in found.problems] == [("frame", "000015.jpg")]


# -- roots -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("content", [None, "empty", "file"])
def test_nothing_to_load_is_one_line(tmp_path, content):
    root = tmp_path / "root"
    if content == "empty":
        root.mkdir()
    elif content == "file":
        root.write_text("x")
    with pytest.raises(InputError) as error:
        find_root(root)
    assert "\n" not in str(error.value)


def test_only_bad_files_is_an_error_and_leaves_no_store(tmp_path):
    with pytest.raises(AvrError, match="no sequence could be loaded"):
        load_reported(tmp_path, {NAME: {"2d": b"x"}})
    with pytest.raises(AvrError):
        Store(tmp_path / "store").manifest()


def test_of_a_file_that_is_refused_nothing_else_is_said(tmp_path, monkeypatch):
    """Its frames are read before its end is seen: what was wrong in them is no news, and no record was 'kept'."""
    twice = json.dumps(person_3d(2, 3.0, 1.0)).replace('"label_id"', '"label_id": "pedestrian:1", "label_id"')
    whole = f'{{"labels": {{"000000.pcd": [{twice}], "000000.pcd": [], "000015.pcd": []}}}}'
    monkeypatch.setattr(labelfile, "BATCH_BYTES", 1)
    _, found = loaded(tmp_path / "whole", whole, "3d")
    assert [p.kind for p in found.problems] == ["field", "frame"]
    for name, cut in (("cut", whole[:-2]), ("longer", whole + "]")):
        _, found = loaded(tmp_path / name, cut, "3d")
        assert [(p.kind, p.count, p.layer) for p in found.problems] == [("file", 1, "3d")]
