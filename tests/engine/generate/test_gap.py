"""Counts of people who are met between keyframes, in a world that is labelled at every frame."""

import pytest
from keyframe_layers import make_prover, proposals, searched
from loaded_stores import memory_store
from worlds import member, person

from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES

NAME = "yard-2020-01-01_0"
RULES = Rules(count_min=2, long_wait_s=4.0, min_wait_s=1.0)
"""Easier than the real ones, so that a short world holds questions."""


def meeting(brief):
    """Person 1 reads, and talks to 2 and 3 all the time and to 4 in the frames `brief`."""
    layers = {"2d": {}, "social": {}}
    for frame in range(106):
        met = {1: [2, 3, *([4] if frame in brief else [])]}
        rows, lists = layers["2d"].setdefault(frame, []), layers["social"].setdefault(frame, [])
        for track in range(1, 5):
            box, actions = (900 * track - 800, 100, 50, 150), {"standing": 1} | ({"reading": 1} if track == 1 else {})
            rows.append(person(track, box, actions, (track, 1)))
            lists.append(member(track, box, interactions=[(one, {"conversation": 1}) for one in met.get(track, [])]))
    return {NAME: layers}


@pytest.mark.parametrize("brief", [range(0), range(50, 56)])
def test_people_who_are_met_between_keyframes_are_counted(tmp_path, brief):
    """A person who is met for a moment only, and at no keyframe, makes the number another one."""
    with searched(memory_store(tmp_path, meeting(brief)), NAME, RULES) as search:
        prover = make_prover(search)
        proven = [prover.prove(one) is not None for one in proposals(search, TEMPLATES["gap_count"])]
    assert len(proven) > 3 and set(proven) == {not brief}
    assert prover.counts == ({"count": len(proven)} if brief else {})
