"""Wrong choices: each is certainly wrong, and names the change of the question that makes it right."""

import json

import pytest
from keyframe_layers import ANY_VIEW, make_all, search_one
from loaded_stores import memory_store
from msgspec.structs import replace
from random_worlds import SEQUENCE, build

from jrdb_avr.engine.generate import pool, run
from jrdb_avr.schema.labels import answer_of_choice
from jrdb_avr.schema.templates import FORMS

CHORUS = [
    f"{20 + n} | {20 * '-'}{pose} | column {2000 + 100 * n} | {action} 20-20"
    for n, (pose, action) in enumerate(zip("wtst", ("typing", "eating sth", "pushing", "holding sth"), strict=True))
]
"""People who each do one thing in the last second, so that these may be choices."""


def named(tmp_path, people, template, *seconds):
    """{wrong choice: its name} of the question at stated seconds."""
    store = memory_store(tmp_path, build([*people, *CHORUS]))
    rules = replace(ANY_VIEW, max_per_person=1000, near_duplicate_s=0.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "FORMS", {template: FORMS[template]})
        patch.setattr(pool, "_DESCRIPTIONS", 100)
        found, candidates = search_one(store, SEQUENCE, rules)
    rows, faults = make_all(store, SEQUENCE, rules, candidates, found.counts)
    assert rows and not faults
    for row in rows:
        times = json.loads(row["plan"])["times"]
        if tuple(times[name]["frame"] // 15 for name in sorted(times) if "frame" in times[name]) == seconds:
            names = zip(map(answer_of_choice, row["choices"]), json.loads(row["distractors"]), strict=True)
            return {label: name for label, name in names if label != row["truth"]}, row["truth"]
    raise AssertionError([row["plan"] for row in rows])


def test_wrong_choices_name_the_mistake_that_leads_to_them(tmp_path):
    people = [
        "1 | sssssssswwwwtttttttt | column 400 | reading 0-0",
        "2 | tttttttttttttttttttt | column 900 | group 1",
    ]
    found, truth = named(tmp_path, people, "change", 0, 10)
    assert truth == "walking"
    expected = {"sitting": "description's time", "standing": "time.shift +3 s"}
    assert found == {label: expected.get(label) for label in found} and found.keys() & expected.keys()


def test_the_look_alike_is_a_mistake_too(tmp_path):
    people = [
        "1 | sssssssswwwwssssssss | column 400 | reading 0-0 | talking to someone 0-0",
        "2 | tttttttttttttttttttt | column 410 | reading 0-0",
        "3 | tttttttttttttttttttt | column 420 | talking to someone 0-0",
    ]
    # Without one of the two actions another person fits, who stands at the time asked.
    found, _ = named(tmp_path, people, "change", 0, 9)
    assert found.get("standing", "look-alike without action ").startswith("look-alike without action ")
