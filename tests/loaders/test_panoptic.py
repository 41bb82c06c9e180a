"""The panoptic layer: what is kept of a file of masks, what is refused, and the objects that follow from it."""

from __future__ import annotations

import json

import pytest
from loaded_stores import NAME, read_store
from worlds import coco_file, member, person, thing

from jrdb_avr.loaders.layers import panoptic
from jrdb_avr.loaders.layers.panoptic import load_panoptic
from jrdb_avr.loaders.problems import Problems
from jrdb_avr.schema.tables import ANNOTATIONS
from jrdb_avr.schema.things import OBJECTS, PERSON_CATEGORIES, normal_category

SHELF, DOOR, WALL, PERSON, TEAPOT = 57, 71, 4, 63, 900


def reading_of(folder, content):
    path = folder / f"{NAME}.json"
    path.write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    problems = Problems(path.name)
    reading = load_panoptic(path, problems).of(NAME)
    for name, table in reading.tables.items():
        assert table.cast(ANNOTATIONS[name]).schema == ANNOTATIONS[name]
    return reading, problems.listed()


def things(reading):
    """(frame, category number, object) of every row, in order."""
    return [(row["frame"], row["category_id"], row["object"]) for row in reading.tables["panoptic"].to_pylist()]


def found(problems):
    return [(p.kind, p.reason, p.count, p.frame, p.field) for p in problems]


@pytest.mark.parametrize("where", ["tracking_id", "attributes.tracking_id", "attributes.floor_id"])
@pytest.mark.parametrize("track", [0, 12, 12.0, "12"])
def test_case_33_a_track_stands_under_three_names(tmp_path, where, track):
    reading, problems = reading_of(tmp_path, coco_file({0: [thing(track, SHELF, where=where)]}, "panoptic"))
    assert things(reading) == [(0, SHELF, int(track))]
    assert problems == []


def test_case_33_the_first_name_that_says_anything_counts(tmp_path):
    rows = [
        thing(1, SHELF, attributes={"tracking_id": 2, "floor_id": 3}),
        thing(None, SHELF, attributes={"tracking_id": 4, "floor_id": 5}, tracking_id=None),
        thing(None, SHELF, attributes={"tracking_id": None, "floor_id": 6}),
        thing(None, SHELF, attributes={"color": "red"}),
        thing("x", SHELF, attributes={"tracking_id": 8}),
        thing(-1, SHELF),
    ]
    reading, problems = reading_of(tmp_path, coco_file({0: rows}, "panoptic"))
    assert [row[2] for row in things(reading)] == [1, 4, 6, None, None, None]
    assert [(kind, count, field) for kind, _, count, _, field in found(problems)] == [("field", 1, "tracking_id")]


def test_case_33_categories_go_by_name_and_tracks_restart_in_each(tmp_path):
    content = coco_file({0: [thing(1, 5), thing(1, 6), thing(1, 6)], 15: [thing(1, 5)]}, "panoptic")
    content["categories"] = [{"id": 6, "name": "shelf"}, {"id": 5, "name": "door"}]
    reading, problems = reading_of(tmp_path, content)
    assert things(reading) == [(0, 5, 1), (0, 6, 1), (15, 5, 1)]
    assert [list(row.values())[1:] for row in reading.tables["categories"].to_pylist()] == [
        [5, "door", "door"],
        [6, "shelf", "shelf"],
    ]
    assert found(problems) == [
        ("record", "same thing twice in a frame, the first is kept", 1, "000000.jpg", "tracking_id")
    ]


SPELLINGS = {
    "TRASH_BIN": "trash_bin",
    "t_door": "door",
    "M_Chair/Sofa": "chair/sofa",
    "light-pole": "light_pole",
    " Floor/Walking  path ": "floor/walking_path",
    "T-table": "table",
    "tableware": "tableware",
    "monitor": "monitor",
    "t_teapot": None,
    "m_": None,
}


@pytest.mark.parametrize("raw", SPELLINGS)
def test_case_33_spellings_of_categories(tmp_path, raw):
    content = coco_file({0: [thing(1, 8)]}, "panoptic") | {"categories": [{"id": 8, "name": raw}]}
    reading, problems = reading_of(tmp_path, content)
    (row,) = reading.tables["categories"].to_pylist()
    assert (row["category"], row["raw"]) == (SPELLINGS[raw], raw.strip())
    assert list(reading.unknown) == ([] if SPELLINGS[raw] else [("categories", normal_category(raw))])
    assert problems == []


def test_every_name_of_the_vocabulary_is_its_own_usual_spelling():
    for name in OBJECTS:
        assert normal_category(name) == name
        assert normal_category(f"T_{name.upper()}") == name
    assert PERSON_CATEGORIES.issubset(OBJECTS)


# -- what is refused -----------------------------------------------------------------------------------------------


def beside_good(record):
    """A file whose frame 15 holds a good thing and a record, which need not be JSON of any use."""
    return coco_file(
        {0: [thing(1, SHELF)], 15: [thing(2, SHELF), {"category_id": DOOR, "tracking_id": 9} | record]}, "panoptic"
    )


GOOD = [(0, SHELF, 1), (15, SHELF, 2)]


BAD_FIELDS = {
    "bbox": [[1, 2, 0, 4]],
    "area": [-1, 1e300],
    "tracking_id": ["one", 1.5, 2**31, -2],
    "segmentation": [
        "abc",
        {"size": [480, 3760]},
        {"size": ["480", "3760"], "counts": "abc"},
        {"size": [480, 3760], "counts": [1.5]},
        [[1, 2, 3, 4]],
        [[1, 2, 3, 4, 5, 6, 7]],
        [["1", 2, 3, 4, 5, 6]],
    ],
}


@pytest.mark.parametrize(
    ("field", "value"), [(field, value) for field, values in BAD_FIELDS.items() for value in values], ids=str
)
def test_a_value_out_of_range_leaves_the_rest_of_its_record(tmp_path, field, value):
    reading, problems = reading_of(tmp_path, beside_good({field: value}))
    track = None if field == "tracking_id" else 9
    assert things(reading) == [*GOOD, (15, DOOR, track)]
    row = reading.tables["panoptic"].to_pylist()[-1]
    assert row[{"bbox": "x", "tracking_id": "object"}.get(field, field)] is None
    assert [(kind, count, frame, name) for kind, _, count, frame, name in found(problems)] == [
        ("field", 1, "000015.jpg", field)
    ]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("bbox", [1, 2, 3]),
        ("area", "12"),
        ("tracking_id", [1]),
        ("attributes", 3),
        *(("category_id", number) for number in (None, 1.5, "one", -1, 2**31)),
    ],
)
def test_a_field_of_another_type_costs_its_record(tmp_path, field, value):
    reading, problems = reading_of(tmp_path, beside_good({field: value}))
    assert things(reading) == GOOD
    assert [(kind, count, frame, name) for kind, _, count, frame, name in found(problems)] == [
        ("record", 1, "annotation 3", field)
    ]


BAD_CATEGORIES = {
    "a name that is no text": {"id": 8, "name": 3},
    "an empty name": {"id": 8, "name": " "},
    "an endless name": {"id": 8, "name": "x" * 1000},
    "no number": {"name": "door"},
    "a negative number": {"id": -8, "name": "door"},
    "no object": 3,
}


@pytest.mark.parametrize("entry", BAD_CATEGORIES.values(), ids=BAD_CATEGORIES)
def test_a_bad_entry_of_the_categories_costs_itself(tmp_path, entry):
    content = coco_file({0: [thing(1, SHELF)]}, "panoptic")
    content["categories"] = [entry, {"id": SHELF, "name": "shelf"}]
    reading, problems = reading_of(tmp_path, content)
    assert reading.tables["categories"]["category_id"].to_pylist() == [SHELF]
    ((kind, _, count, _, field),) = found(problems)
    assert (kind, count) == ("record", 1)
    assert field in ("categories", "id", "name") or entry == 3


def test_a_category_number_of_two_names_stands_for_neither(tmp_path):
    content = coco_file({0: [thing(1, 8), thing(1, 9)]}, "panoptic")
    names = {8: ["shelf", "door"], 9: ["door", "DOOR"]}
    content["categories"] = [{"id": number, "name": name} for number in names for name in names[number]]
    reading, problems = reading_of(tmp_path, content)
    assert [(r["category_id"], r["category"]) for r in reading.tables["categories"].to_pylist()] == [(9, "door")]
    assert things(reading) == [(0, 8, 1), (0, 9, 1)]
    assert sorted((p.kind, p.count, p.field) for p in problems) == [
        ("field", 1, "category_id"),
        ("record", 1, "categories"),
    ]


@pytest.mark.parametrize("categories", [None, ...])
def test_without_a_list_of_categories_things_are_unknown(tmp_path, categories):
    content = coco_file({0: [thing(1, SHELF)]}, "panoptic") | {"categories": categories}
    if categories is ...:
        del content["categories"]
    reading, problems = reading_of(tmp_path, content)
    assert things(reading) == [(0, SHELF, 1)]
    assert reading.tables["categories"].num_rows == 0
    assert [(p.kind, p.field) for p in problems] == [("field", "category_id"), ("file", "categories")]


def test_masks_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(panoptic, "MAX_SEGMENTATION", 100)
    reading, problems = reading_of(tmp_path, beside_good({"segmentation": {"size": [480, 3760], "counts": "a" * 100}}))
    assert [text is None for text in reading.tables["panoptic"]["segmentation"].to_pylist()] == [False, False, True]
    assert [(p.kind, p.field, p.count) for p in problems] == [("field", "segmentation", 1)]


# -- objects -------------------------------------------------------------------------------------------------------


def objects(folder, frames, handles, categories=None):
    """Objects of a panoptic file beside 2D boxes; `handles`: (frame, person, object, category)."""
    box = (100, 60, 50, 200)
    layers = {"2d": {f: [person(1, box)] for f in range(32)}, "panoptic": coco_file(frames, "panoptic")}
    if categories:
        layers["panoptic"]["categories"] = [{"id": number, "name": name} for number, name in categories.items()]
    layers["reasoning"] = {f: [member(t, box, handles=[(pair, {"holding": "1"})])] for f, t, *pair in handles}
    store, _ = read_store(folder, layers)
    return [tuple(row.values())[1:] for row in store.interval("objects", NAME).to_pylist()]


def test_what_people_handle_is_an_object_where_no_mask_shows_it_too(tmp_path):
    handles = [(0, 1, 2, SHELF), (1, 1, 8, DOOR), (2, 1, 8, DOOR), (3, 1, 4, 12), (4, 1, 5, PERSON), (5, 1, 0, SHELF)]
    assert objects(tmp_path, {15: [thing(2, SHELF)]}, handles) == [
        (4, 12, None, None, None),
        (0, SHELF, "shelf", None, None),
        (2, SHELF, "shelf", 15, 15),
        (8, DOOR, "door", None, None),
    ]


@pytest.mark.parametrize("name", sorted(PERSON_CATEGORIES))
def test_people_are_left_out_under_any_number_and_spelling(tmp_path, name):
    categories = {3: f"T_{name.upper()}", 4: "bag"}
    assert objects(tmp_path, {0: [thing(1, 3), thing(1, 4)]}, [(0, 1, 9, 3)], categories) == [(1, 4, "bag", 0, 0)]
