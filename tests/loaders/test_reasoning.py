"""Reasoning files: what people do with things, and the social facts where no social file gives them."""

from __future__ import annotations

import functools

from label_records import BOX, read, record, rows
from worlds import member

from jrdb_avr.loaders.layers.social import load_reasoning

things_alone = functools.partial(load_reasoning, social=False)


def handling(*pairs):
    return [{"inter_labels": verbs, "pair": pair} for pair, verbs in pairs]


def test_where_a_record_of_a_person_is_lost_no_list_of_things_is_whole(tmp_path):
    people = [member(1, BOX, handles=[((12, 17), {"holding": "1"})]), member(1, BOX, handles=[]), member(2, BOX)]
    reading, _ = read(tmp_path, people, things_alone)
    assert rows(reading, "handles") == [(0, 1, 12, 17, "holding", 1)]
    assert rows(reading, "listed") == []


def test_beside_a_social_file_only_things_are_read(tmp_path):
    content = [member(1, BOX, {"gender": {"Male": "x"}}, [(1, {"hugging": "1"})], None, [((0, 0), {"holding": "1"})])]
    reading, problems = read(tmp_path, content, things_alone)
    assert set(reading.tables) == {"handles", "listed"}
    assert set(reading.frames) == {"handles"}
    assert rows(reading, "handles") == [(0, 1, 0, 0, "holding", 1)]
    # What is wrong with the social part is not of interest here.
    assert problems == []


def test_case_09_verbs_in_every_spelling(tmp_path):
    verbs = {"looking_at": "1", "Finding something": "1", "talking-on": "1", "juggling_balls": "2"}
    reading, problems = read(tmp_path, [record(HOI=handling(([3, 17], verbs)))], things_alone)
    assert [row[4] for row in rows(reading, "handles")] == [
        "finding_something",
        "juggling balls",
        "looking at",
        "talking on",
    ]
    assert dict(reading.unknown) == {("HOI", "juggling balls"): 1}
    assert problems == []
