"""Social files: demographics, interactions and group information, from the text to the annotation tables.

Worlds are small enough to see through. What is refused is counted and leaves no fact; what is not known is not false.
"""

from __future__ import annotations

import pytest
from label_records import BOX, NAME, read, reasons, record, rows
from loaded_stores import load_root
from worlds import member, write_root

from jrdb_avr.loaders.root import find_root
from jrdb_avr.schema.labels import (
    INTERACTIONS,
    VALUES,
    normal_interaction,
    normal_values,
)


def talk(*pairs):
    """Interaction entries, of (pair, labels)."""
    return [{"pair": pair, "inter_labels": labels} for pair, labels in pairs]


# -- vocabulary --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("attribute", sorted(VALUES))
def test_every_value_of_the_vocabulary_is_its_own_spelling_and_comes_in_any(attribute):
    for value in VALUES[attribute]:
        for written in (value, value.upper(), value.replace("_", "-"), value.replace("_", " "), f" {value} "):
            assert normal_values(attribute, written) == (value,)


@pytest.mark.parametrize(
    ("attribute", "written", "values"),
    [
        ("gender", "Male", ["male"]),
        ("gender", "impossible", [None]),
        ("age", "Young_Adulthood", ["young adulthood"]),
        ("age", "middle-aged", ["middle adulthood"]),
        ("age", "elderly", ["late adulthood"]),
        ("ethnicity", "Caucasian/White", ["caucasian/white"]),
        ("venue", "indoor:room/class", ["indoor_room/class"]),
        ("venue", "Indoor: Study Space", ["indoor_study_space"]),
        ("aim", "socializing&commuting", ["socializing", "commuting"]),
        ("aim", "socializing & Socializing", ["socializing"]),
        ("aim", "waiting for someone/something", ["waiting_for_someone/something"]),
        ("aim", "unknown", [None]),
        ("ssc", "food-truck", ["food_truck"]),
        ("ssc", "garbage-bin", ["bin"]),
        ("inter", "standing together together", ["standing together"]),
        ("gender", "Robot_Like", ["robot like"]),
        ("aim", "&", []),
    ],
)
def test_spellings_of_attributes(attribute, written, values):
    assert list(normal_values(attribute, written)) == values


@pytest.mark.parametrize(
    ("written", "label"),
    [
        ("standing together together", "standing together"),
        ("holding_something_together", "holding sth together"),
        ("looking at something together", "looking at sth together"),
        ("looking-into sth together", "looking into sth together"),
        ("Pointing at something together", "pointing at sth together"),
        ("dancing_together", "dancing together"),
        *((label, label) for label in INTERACTIONS),
    ],
)
def test_spellings_of_interactions(written, label):
    assert normal_interaction(written) == label


# -- what files say ----------------------------------------------------------------------------------------------


def test_case_09_unknown_labels_are_kept_and_counted(tmp_path):
    said = {"gender": {"Unsure_yet": "1"}, "race": {"impossible": "1"}}
    info = {"SSC": {"food-truck": "1", "Ice-cream Stand": "1"}, "aim": {"socializing&juggling": "1"}}
    content = {f: [member(1, BOX, said, [(2, {"Dancing_together": "1"})], info)] for f in (0, 1)}
    reading, problems = read(tmp_path, content)
    assert dict(reading.unknown) == {
        ("demographics_info.gender", "unsure yet"): 2,
        ("group_info.SSC", "ice cream stand"): 2,
        ("group_info.aim", "juggling"): 2,
        ("H-interaction", "dancing together"): 2,
    }
    assert (0, 1, 2, "dancing together", 1) in rows(reading, "interactions")
    assert problems == []


# -- broken input ------------------------------------------------------------------------------------------------

GOOD = {"gender": {"Male": "1"}}

ENTRIES = {
    "no pair": ({"inter_labels": {"hugging": "1"}}, "pair: missing"),
    "null pair": ({"pair": None, "inter_labels": {"hugging": "1"}}, "pair: missing"),
    "a bool": ({"pair": True, "inter_labels": {"hugging": "1"}}, "pair: not a number"),
    "half a person": ({"pair": 2.5, "inter_labels": {"hugging": "1"}}, "pair: not a whole number"),
    "negative": ({"pair": -1, "inter_labels": {"hugging": "1"}}, "pair: number out of range"),
    "too large": ({"pair": 2**31 - 1, "inter_labels": {"hugging": "1"}}, "pair: number out of range"),
    "no person": ({"pair": "person:-1", "inter_labels": {"hugging": "1"}}, "pair: label_id is not pedestrian:N"),
    "oneself": ({"pair": 1, "inter_labels": {"hugging": "1"}}, "pair is the person itself"),
    "no labels": ({"pair": 2}, "inter_labels is missing"),
    "labels a list": ({"pair": 2, "inter_labels": ["hugging"]}, "not an object"),
    "empty label": ({"pair": 2, "inter_labels": {"": "1"}}, "label: empty text"),
    "endless label": ({"pair": 2, "inter_labels": {"h" * 101: "1"}}, "label: text too long"),
}


@pytest.mark.parametrize("name", ENTRIES)
def test_a_broken_entry_leaves_the_others_but_the_list_is_not_whole(tmp_path, name):
    entry, reason = ENTRIES[name]
    entries = [*talk((3, {"conversation": "1"})), entry, *talk((4, {"conversation": "1"}))]
    other = {"label_id": "pedestrian:5", "box": list(BOX), "H-interaction": []}
    reading, problems = read(tmp_path, [record(demographics_info=[GOOD], **{"H-interaction": entries}), other])
    assert rows(reading, "interactions") == [(0, 1, 3, "conversation", 1), (0, 1, 4, "conversation", 1)]
    assert rows(reading, "demographics") == [(0, 1, "gender", "male", 1)]
    assert rows(reading, "listed") == [("interactions", 0, 5)]
    assert reasons(problems) == [(reason, "H-interaction", "000000.jpg", 1)]


def test_case_36_a_record_with_both_names_has_both_lists(tmp_path):
    entries, others = talk((2, {"hugging": "1"})), talk((3, {"conversation": "1"}))
    reading, problems = read(tmp_path, [record(HHI=entries, **{"H-interaction": others})])
    assert rows(reading, "interactions") == [(0, 1, 2, "hugging", 1), (0, 1, 3, "conversation", 1)]
    assert problems == []


def test_an_impossible_interaction_is_no_fact_and_no_denial(tmp_path):
    entries = talk((2, {"impossible": "1", "hugging": "1"}))
    reading, problems = read(tmp_path, [record(**{"H-interaction": entries})])
    assert rows(reading, "interactions") == [(0, 1, 2, "hugging", 1)]
    assert rows(reading, "listed") == []
    assert problems == []


@pytest.mark.parametrize(
    ("label_id", "reason"),
    [
        ("pedestrian:1", "same person twice in a frame"),
        ("Pedestrian:1", "label_id is not pedestrian:N"),
        ("other:3", "label_id is not pedestrian:N"),
    ],
)
def test_a_lost_record_of_a_person_leaves_nobody_a_list_and_no_votes(tmp_path, label_id, reason):
    lost = member(1, BOX, {"gender": {"Female": "1"}}, [(3, {"hugging": "1"})]) | {"label_id": label_id}
    frame = [member(1, BOX, GOOD, [(2, {"hugging": "1"})]), member(2, BOX, GOOD, []), lost]
    reading, problems = read(tmp_path, {0: frame, 1: frame[:2]})
    assert rows(reading, "interactions") == [(f, 1, 2, "hugging", 1) for f in (0, 1)]
    assert rows(reading, "listed") == [("interactions", 1, 1), ("interactions", 1, 2)]
    assert {row[0] for row in rows(reading, "demographics")} == {1}
    assert [p.reason for p in problems] == [reason]


def test_a_file_that_gives_the_boxes_too_is_reported_once(tmp_path):
    records = [record(box=[1, 2, -3, 4]), record(label_id="dog"), 7, member(2, BOX, {"gender": {"Male": "x"}})]
    root = write_root(tmp_path / "root", {NAME: {"social": {0: records}}})
    (files,) = find_root(root).sequences
    assert set(files.labels) == {"2d", "social"}
    _, report = load_root(tmp_path, root)
    assert sorted((p.field, p.count) for p in report.problems) == [
        ("", 1),
        ("box", 1),
        ("demographics_info.gender", 1),
        ("label_id", 1),
    ]
