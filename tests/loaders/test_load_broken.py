"""Broken input: every kind is refused or skipped alone, counted with file, frame and field; the rest loads.

Each case is one record or file put beside good ones. Nothing gives a traceback, nothing becomes a wrong fact.
"""

from __future__ import annotations

import json
import os

import msgspec
import pyarrow.compute as pc
import pytest
from loaded_stores import NAME, read_store, without_graph
from worlds import load_reported, person, person_3d, write_root

from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.engine.rederive.truth import TRUE, UNKNOWN
from jrdb_avr.loaders.labelfiles import frames as labelfile
from jrdb_avr.loaders.labelfiles.frames import MAX_RECORDS
from jrdb_avr.schema.rules import Rules

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


BAD_BOXES = [1, 1, 0, 5], [1, 1, 5, -5], [1, 1, 5], ["1", "1", "5", "5"], None, ...
BAD_IDS = ..., None, "pedestrian:-1", "pedestrian:99999999999999999999", "pedestrian:1.5"


@pytest.mark.parametrize(
    ("field", "value"), [*(("box", box) for box in BAD_BOXES), *(("label_id", label) for label in BAD_IDS)]
)
def test_a_bad_box_or_id_costs_its_own_record(tmp_path, field, value):
    store, found = loaded(tmp_path, raw_2d(variant(**{field: value}), json.dumps(GOOD)))
    assert boxes(store) == [(0, 1), (15, 1)]
    ((kind, reason, *rest),) = problems_of(found)
    assert [kind, *rest] == ["record", 1, f"{NAME}.json", "000015.jpg", field] and reason
    # Somebody was there whom we could not place: the frame proves nobody's absence and nothing unique.
    assert store.interval("frames", NAME)["annotated"].to_pylist() == [True, False]
    assert store.interval("sequence", NAME)["keyframes"].to_pylist() == [[0]]


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


@pytest.mark.parametrize(
    "key", ["15.jpg", "000015", "000015.pcd", "-00015.jpg", "0000015.jpg", "x.jpg", "", "٠٠٠٠١٥.jpg"]
)
def test_a_bad_frame_key_is_refused(tmp_path, key):
    store, found = loaded(tmp_path, {0: [GOOD], key: [GOOD]})
    assert boxes(store) == [(0, 1)]
    assert [(p.kind, p.frame) for p in found.problems] == [("frame", key)]


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    store, found = loaded(tmp_path, b"\xef\xbb\xbf" + json.dumps({"labels": {"000000.jpg": [GOOD]}}).encode())
    assert (boxes(store), found.problems) == ([(0, 1)], [])


# -- fields: the record stays, the field is lost ---------------------------------------------------------------


@pytest.mark.parametrize("code", [0, 4, -1, 1.5, "x", "", None, [1], {}, True, 10**30, "1.0.0"])
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


@pytest.mark.parametrize("value", [{}, None, ..., {"impossible": 1}, [], "walking", 3, ["walking"], True])
def test_no_usable_actions_are_no_list_and_another_type_is_a_problem(tmp_path, value):
    store, found = loaded(tmp_path, raw_2d(variant(action_label=value)))
    assert store.annotation("boxes_2d", NAME)["has_actions"].to_pylist() == [True, False]
    another = isinstance(value, list | str | int)
    assert [(p.kind, p.field) for p in found.problems] == [("field", "action_label")] * another


@pytest.mark.parametrize(
    ("field", "changes"),
    [
        ("attributes", {"attributes": [1]}),
        ("attributes.occlusion", {"attributes": {"occlusion": 3}}),
    ],
)
def test_a_field_of_another_type_costs_its_record(tmp_path, field, changes):
    store, found = loaded(tmp_path, raw_2d(variant(**changes), json.dumps(GOOD)))
    assert boxes(store) == [(0, 1), (15, 1)]
    assert store.interval("frames", NAME)["annotated"].to_pylist() == [True, False]
    ((problem),) = found.problems
    assert (problem.kind, problem.frame, problem.field) == ("record", "000015.jpg", field)
    # The report names the record.
    assert "pedestrian:2" in problem.detail


def test_whoever_may_be_excluded_from_the_evaluation_is_not_clear(tmp_path):
    store, found = loaded(tmp_path, raw_2d(variant(attributes={"occlusion": "Fully_visible", "no_eval": 1})))
    assert store.interval("sightings", NAME)["clear"].to_pylist() == [True, False]
    assert [(p.kind, p.field, p.frame) for p in found.problems] == [("field", "attributes.no_eval", "000015.jpg")]


# -- 3D --------------------------------------------------------------------------------------------------------


def with_3d(**changes):
    record = person_3d(2, 1.0, 2.0)
    box = {key: value for key, value in (record["box"] | changes).items() if value is not ...}
    return {0: [person_3d(1, 3.0, 0.0), record | {"box": box}]}


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"rot_z": None}, "box.rot_z"),
        ({"cz": "1"}, "box.cz"),
        ({"w": ...}, "box.w"),
        ({"h": 0}, "box"),
        ({"cx": 1e9}, "box"),
    ],
)
def test_a_bad_3d_box_costs_its_frame(tmp_path, changes, field):
    store, found = loaded(tmp_path, with_3d(**changes) | {15: [person_3d(1, 3.0, 0.0)]}, "3d")
    assert boxes(store, "boxes_3d") == [(15, 1)]
    assert [p[:1] + p[2:3] + p[4:] for p in problems_of(found)] == [("record", 1, "000000.pcd", field)]


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
    "truncated": WHOLE[: len(WHOLE) // 2].encode(),
    "last bracket missing": WHOLE[:-1].encode(),
    "not UTF-8": WHOLE.encode().replace(b"walking", b"walk\xff\xfeg"),
    "NaN": WHOLE.replace("200", "NaN").encode(),
    "UTF-16": WHOLE.encode("utf-16"),
    "a list": b"[1, 2]",
    "a number": b"7",
    "no labels": b'{"detections": {}}',
    "labels are a list": b'{"labels": []}',
    "no frames": b'{"labels": {}}',
    "a picture": b"\xff\xd8\xff\xe0" + bytes(range(256)),
    "nested deeply": b"[" * 200_000,
    "only bad frames": b'{"labels": {"x": [], "y": []}}',
    "a frame twice": WHOLE[:-2] + ', "0000\\u00315.jpg" : []}}',
    "labels twice": WHOLE[:-1] + ', "labels": {}}',
}


@pytest.mark.parametrize("content", BAD_FILES.values(), ids=BAD_FILES)
def test_a_bad_file_is_refused_as_a_whole(tmp_path, content):
    store, found = loaded(tmp_path, content)
    assert not found.frames and boxes(store) == []
    if content != BAD_FILES["only bad frames"]:
        (problem,) = found.problems
        assert (problem.kind, problem.file, problem.count) == ("file", f"{NAME}.json", 1)
        assert problem.reason.startswith(NAME) and "\n" not in problem.reason


@pytest.mark.parametrize("layer", ["3d", "social", "reasoning", "pose", "panoptic", "timestamps", "calibration"])
@pytest.mark.parametrize("name", ["empty", "truncated", "a list", "nested deeply"])
def test_a_bad_file_of_another_layer_costs_that_layer_alone(tmp_path, layer, name):
    content = {"images": BAD_FILES[name]} if layer == "timestamps" else BAD_FILES[name]
    store, found = read_store(tmp_path, {"2d": {0: [GOOD]}, layer: content})
    assert list(found.frames) == ["2d", "actions", "groups", "images"]
    assert boxes(store) == [(0, 1)]
    (problem,) = found.problems
    assert (problem.kind, problem.count) == ("file", 1)
    assert problem.file and "\n" not in problem.reason


def test_the_good_files_beside_bad_ones_load(tmp_path, graphless):
    world = {f"bad-{i}": {"2d": content} for i, content in enumerate(BAD_FILES.values())}
    store, reports = load_reported(tmp_path, world | {"good-1": {"2d": {0: [GOOD]}}})
    assert list(store.manifest().sequences) == ["good-1"]
    assert [report.sequence for report in reports] == sorted([*world, "good-1"])
    assert [path.stem for path in (store.path / "intervals" / "sightings").iterdir()] == ["good-1"]


def test_what_is_no_file_is_refused(tmp_path, graphless):
    world = {"good-1": {"2d": {0: [GOOD]}}}
    folder = write_root(tmp_path / "root", world) / "labels" / "labels_2d_stitched"
    (folder / "folder-1.json").mkdir()
    (folder / "loop-1.json").symlink_to(folder / "loop-1.json")
    (folder / "gone-1.json").symlink_to(folder / "nothing")
    os.mkfifo(folder / "pipe-1.json")
    (folder / "bad name!.json").write_text("{}")
    (folder / os.fsdecode(b"bad\xff.json")).write_text("{}")
    (folder / "notes.txt").write_text("x")
    store, reports = load_reported(tmp_path, world)
    assert list(store.manifest().sequences) == ["good-1"]
    refused = {problem["file"] for report in reports for problem in msgspec.to_builtins(report)["problems"]}
    assert refused == {"folder-1.json", "loop-1.json", "gone-1.json", "pipe-1.json", "bad name!.json", "bad .json"}
    assert json.loads(msgspec.json.encode(reports)), "a file name that is no Unicode can be reported"


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


@pytest.mark.parametrize("text", [WHOLE + " " * 1000, WHOLE + "x" * 1000])
def test_a_file_over_the_limit_is_refused(tmp_path, monkeypatch, text, graphless):
    monkeypatch.setattr(labelfile, "MAX_FILE", 1000)
    world = {NAME: {"2d": text}, "good-1": {"2d": {0: [GOOD]}}}
    _, reports = load_reported(tmp_path, world)
    assert "larger than the limit" in reports[1].problems[0].reason


CROWDS = {
    "people": [person(i, (1, 2, 30, 40)) for i in range(MAX_RECORDS + 1)],
    "numbers": [0] * (MAX_RECORDS + 1),
    "many bytes": [" " * labelfile.MAX_FRAME],
    **{"a number": 3, "null": None, "a text": "x", "an object": {}, "true": True},
}


@pytest.mark.parametrize("crowd", CROWDS.values(), ids=CROWDS)
def test_frames_too_full_to_be_real_or_of_another_type_are_refused_and_not_known(tmp_path, crowd):
    store, found = loaded(tmp_path, {0: [GOOD], 15: crowd})
    assert boxes(store) == [(0, 1)] and store.interval("frames", NAME)["frame"].to_pylist() == [0]
    assert [(p.kind, p.frame) for p in found.problems] == [("frame", "000015.jpg")]
