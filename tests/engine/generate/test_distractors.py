"""The choices of a question: each wrong one is known to be wrong, and says which mistake leads to it."""

import json

import pytest
from keyframe_layers import search_one
from loaded_stores import memory_store
from random_worlds import SEQUENCE, build
from worlds import person

from jrdb_avr.engine.generate import run
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import FORMS


def kept(tmp_path, world, template):
    """The kept candidates of a template, by stated seconds."""
    store = memory_store(tmp_path, world)
    rules = Rules(max_per_person=1000, near_duplicate_s=0.0, near_presence_s=0.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "FORMS", {template: FORMS[template]})
        found = search_one(store, SEQUENCE, rules)
    return {tuple(t // 15 for t in row["times"]): row for row in found.pool.to_pylist()}


def told(row):
    """{choice: perturbation} of the wrong choices."""
    pairs = zip(row["choices"], json.loads(row["distractors"]), strict=True)
    return {text: why for text, why in pairs if text != row["answer_text"]}


def test_wrong_poses_come_from_mistakes_first(tmp_path):
    world = build(
        [
            "1 | sssssssswwwwtttttttt | column 400 | reading 0-0",
            "2 | tttttttttttttttttttt | column 900 | group 1",
        ]
    )
    row = kept(tmp_path, world, "change")[0, 10]
    assert row["answer_text"] == "walking"
    assert row["choices"][json.loads(row["answer"])["choice"] - 1] == "walking"
    found = told(row)
    assert found["sitting"] == "pose at t0"
    assert found["standing"] == "time.shift +3 s"
    assert None in found.values()


def test_the_look_alike_is_a_mistake_too(tmp_path):
    world = build(
        [
            "1 | sssssssswwwwssssssss | column 400 | reading 0-0 | talking to someone 0-0",
            "2 | tttttttttttttttttttt | column 410 | reading 0-0",
            "3 | tttttttttttttttttttt | column 420 | talking to someone 0-0",
        ]
    )
    # Dropping one of the two actions lets somebody else in, who stands at the asked time.
    row = kept(tmp_path, world, "change")[0, 9]
    assert told(row)["standing"].startswith("look-alike without action ")


def test_the_look_alike_goes_on_in_another_way(tmp_path):
    world = build(
        [
            "1 | sssssssssssswwwwwwww | column 400 | reading 0-0 | talking to someone 0-0",
            "2 | wwwwwwtttttttttttttt | column 410 | reading 0-0",
            "3 | tttttttttttttttttttt | column 420 | talking to someone 0-0",
        ]
    )
    row = kept(tmp_path, world, "consequence")[0,]
    assert row["answer_text"] == "walking"
    found = told(row)
    assert found["sitting"] == "pose at t0"
    # The one stands up from walking; the other stands from beginning to end, which is no next pose.
    assert found["standing"] == "look-alike without action talking to someone"
    assert list(found.values()).count(None) == 1


def test_the_look_alike_leads_somewhere_else(tmp_path):
    world = build(
        [
            "1 | tttttttt | column 400 | reading 2-2 | talking to someone 2-2",
            "2 | tttttttt | column 300",
            "3 | ssssssss | column 200",
            "4 | tttttttt | column 2000 | reading 2-2",
            "5 | tttttttt | column 1900",
            "6 | wwwwwwww | column 1800",
            "7 | tttttttt | column 2600 | talking to someone 2-2",
        ]
    )
    row = kept(tmp_path, world, "two_hop")[2,]
    assert (row["target_track"], row["answer_text"]) == (3, "sitting")
    found = told(row)
    assert found["standing"] == "hop.stop(1)"
    # The same two steps from 4, who reads too, lead to 6; those from 7 to 5 and on to 4, who stands.
    assert found["walking"] == "look-alike without action talking to someone"


def test_presence_offers_all_four_answers(tmp_path):
    world = build(["1 | sssssssss--------- | column 400", "2 | tttttttttttttttttt | column 900"])
    # Of the same two times after different descriptions only one question is kept.
    row = next(row for when, row in kept(tmp_path, world, "presence").items() if when[1:] == (7, 12))
    assert row["answer_text"] == "only at the first time"
    assert len(set(row["choices"])) == 4
    assert told(row)["neither time"] == "time.shift +3 s"


def test_a_pose_in_a_closed_gap_is_no_choice(tmp_path):
    # 15 labels a second. At frame 150 the list lacks walking for three frames only: walking is unknown there.
    labels = {}
    for frame in range(0, 241):
        mine = {"sitting": 1} if frame < 120 else {"standing": 1} if 149 <= frame <= 151 else {"walking": 1}
        if frame < 10:
            mine |= {"reading": 1}
        here = [person(1, (400, 100, 50, 150), mine), person(2, (900, 100, 50, 150), {"bending": 1})]
        labels[frame] = here
    rows = kept(tmp_path, {SEQUENCE: {"2d": labels}}, "change")
    assert rows[0, 10]["answer_text"] == "standing"
    assert "walking" not in rows[0, 10]["choices"]
    assert "walking" in rows[0, 9]["choices"]
