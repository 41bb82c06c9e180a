"""Intervals of social facts: interactions between two people, votes on demographics and on group information."""

from __future__ import annotations

import pytest
from label_records import placed
from loaded_stores import NAME, reported_store
from worlds import member, person


def loaded(tmp_path, social, boxes=None, **rules):
    """Store and report of a social file beside 2D boxes; by default everybody of the social file has a box."""
    if boxes is None:
        boxes = {f: [person(_track(r), r["box"]) for r in records] for f, records in social.items()}
    return reported_store(tmp_path, {"2d": boxes, "social": social}, **rules)


def _track(record):
    return int(record["label_id"].split(":")[1])


def spans(store, kind="interactions"):
    names = [n for n in store.interval(kind, NAME).column_names if n not in ("sequence", "first_s", "last_s")]
    return [tuple(row[n] for n in names) for row in store.interval(kind, NAME).to_pylist()]


def scene(*people):
    """Social records of people 1, 2, ...: each gives its interactions, or None for no list."""
    return [member(i, placed(i), None, talks) for i, talks in enumerate(people, 1)]


def test_case_29_what_one_says_holds_for_both(tmp_path):
    talking = [(2, {"conversation": "1"})]
    store, report = loaded(tmp_path, {f: scene(talking, []) for f in range(3)})
    assert spans(store) == [(1, 2, "conversation", 0, 2, True), (2, 1, "conversation", 0, 2, True)]
    assert report.absent_partners == 0


def test_case_29_the_easier_of_two_codes_counts(tmp_path):
    hard, easy = [(2, {"hugging": "3"})], [(1, {"hugging": "2"}), (1, {"hugging": "3"})]
    store, _ = loaded(tmp_path, {0: scene(hard, easy), 1: scene(hard, []), 2: scene(None, [(1, {"hugging": "?"})])})
    assert spans(store)[:2] == [(1, 2, "hugging", 0, 0, True), (1, 2, "hugging", 1, 2, False)]


def test_case_29_partners_without_a_box_are_counted(tmp_path):
    talks = [(2, {"hugging": "1"}), (9, {"hugging": "1", "conversation": "1"})]
    boxes = {
        0: [person(1, placed(1)), person(2, placed(2), attributes={"no_eval": True, "occlusion": "Fully_occluded"})]
    }
    store, report = loaded(tmp_path, {0: scene(talks, [], [(1, {"hugging": "1"})])}, boxes)
    # Person 2 has a box of the worst quality; 9 and 3 have none.
    assert spans(store) == [(1, 2, "hugging", 0, 0, True), (2, 1, "hugging", 0, 0, True)]
    assert report.absent_partners == 3


def test_at_one_frame_per_second_nothing_is_bridged(tmp_path):
    talking = [(2, {"conversation": "1"})]
    frames = {f: scene(talking if f != 45 else [], []) for f in range(0, 90, 15)}
    store, _ = loaded(tmp_path, frames)
    assert [row for row in spans(store) if row[0] == 1] == [
        (1, 2, "conversation", 0, 30, True),
        (1, 2, "conversation", 60, 75, True),
    ]
    assert spans(store, "possible_interactions") == []


@pytest.mark.parametrize("said", [([(3, {"hugging": "1"})], [], None), ([], [], [(1, {"hugging": "1"})])])
def test_whoever_is_with_somebody_without_a_box_may_be_with_others(tmp_path, said):
    """Person 3 has no box; person 1 names it, or it names person 1."""
    store, _ = loaded(tmp_path, {0: scene(*said)}, {0: [person(t, placed(t)) for t in (1, 2)]})
    assert store.interval("sightings", NAME)["interactions_listed"].to_pylist() == [False, True]


def test_case_37_a_vote_that_differs_makes_the_attribute_unknown(tmp_path):
    said = {
        1: ["Male"] * 3 + ["Female"] * 2,
        2: ["Male"] * 2 + ["Female"] * 2 + ["impossible"],
        3: ["impossible"] * 4 + ["female"],
    }
    frames = {f: [member(t, placed(t), {"gender": {said[t][f]: "1"}}) for t in said] for f in range(5)}
    store, report = loaded(tmp_path, frames)
    assert store.interval("persons", NAME)["gender"].to_pylist() == [None, None, "female"]
    assert spans(store, "demographics") == [
        (1, "gender", "female", 2, False),
        (1, "gender", "male", 3, True),
        (2, "gender", "female", 2, False),
        (2, "gender", "male", 2, False),
        (3, "gender", "female", 1, True),
    ]
    assert [(d.subject, d.attribute, d.votes, d.stated) for d in report.disagreements] == [
        ("person 1", "gender", {"female": 2, "male": 3}, 5),
        ("person 2", "gender", {"female": 2, "male": 2}, 4),
    ]
