"""True and false choices: the rules, against a brute-force reading of them on tiny people."""

from itertools import combinations, product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jrdb_avr.engine.generate.choices import (
    ListedActions,
    false_labels,
    true_labels,
    wrong_choices,
    wrong_sets,
)
from jrdb_avr.queries.compiler.reads import outcome_of_action
from jrdb_avr.schema.choice_labels import CALLED, CHOICE_LABELS, implied_actions, may_be_same
from jrdb_avr.schema.labels import ACTIONS, POSES

SOME = ("walking", "standing", "sitting", "cycling", "holding sth", "typing", "reading", "pulling", "looking into sth")
ALL = frozenset(ACTIONS)


@st.composite
def timelines(draw):
    timeline = {}
    for frame in range(0, 150, 15):
        if draw(st.integers(0, 5)):
            certain = draw(st.frozensets(st.sampled_from(SOME), max_size=3))
            hard = draw(st.frozensets(st.sampled_from(SOME), max_size=1)) - certain
            timeline[frame] = ListedActions(certain, hard, bool(draw(st.integers(0, 5))))
    return timeline


@given(timelines())
def test_choices_follow_the_rules_read_one_by_one(timeline):
    for frame, label in product(range(0, 150, 15), CHOICE_LABELS):
        true, false = read_one_by_one(timeline, frame, label)
        assert (label in true_labels(timeline, frame)) == true
        assert (label in false_labels(timeline, frame)) == false


def read_one_by_one(timeline, frame, label):
    """Whether an action may be the right choice, and whether it may be a wrong one."""

    def has(at, hard):
        labels = timeline.get(at)
        return labels is not None and (label in labels.certain or (hard and label in labels.hard))

    true = has(frame, False) and (has(frame - 15, False) or has(frame + 15, False))
    labels = timeline.get(frame)
    false = labels is not None and labels.complete
    if false:
        listed = [*labels.certain, *labels.hard]
        poses = [one for one in listed if one in POSES]
        false = label not in listed and not any(label in CALLED[one] for one in listed)
        if label in POSES:
            false = false and len(poses) == 1 and poses[0] in labels.certain
    window = 15 if label in POSES else 45
    seen = any(has(at, True) for at in range(frame - window, frame + window + 1, 15))
    return true, false and not seen


@given(st.frozensets(st.sampled_from(CHOICE_LABELS), max_size=8))
def test_triples_are_all_sets_without_two_actions_that_may_be_called_the_same(wrong):
    expected = {
        three
        for three in combinations(sorted(wrong), 3)
        if all(not may_be_same(one, other) for one, other in combinations(three, 2))
    }
    assert set(wrong_sets(wrong)) == expected
    assert len(wrong_sets(wrong)) == len(expected)


@pytest.mark.parametrize(
    ("word", "implied"),
    [
        ("conversation", {"talking to someone", "listening to someone"}),
        ("eating together", {"eating sth"}),
        ("sitting together", {"sitting", "cycling", "bending"}),
        ("holding", {"holding sth", "looking into sth", "typing", "writing"}),
        ("moving together", set()),
    ],
)
def test_words_of_a_question_imply_actions(word, implied):
    assert implied <= implied_actions(word)
    assert bool(implied) == bool(implied_actions(word))


def test_a_choice_is_not_stated_nor_called_like_the_right_one_and_occurs_in_the_sequence():
    false = frozenset(CHOICE_LABELS) - {"walking"}
    found = wrong_choices("walking", false, implied_actions("conversation"), ALL)
    assert not found & {"talking to someone", "listening to someone", "talking on the phone"}
    assert not found & {"running", "going upstairs", "bending"}
    assert {"sitting", "holding sth"} <= found
    assert wrong_choices("walking", false, implied_actions("conversation"), frozenset({"sitting"})) == {"sitting"}
    assert not wrong_choices("walking", false, implied_actions("walking together"), ALL)


def test_what_choices_may_be_called_goes_beyond_descriptions():
    assert may_be_same("talking to someone", "listening to someone")
    assert may_be_same("typing", "writing")
    assert "sitting" not in CALLED["typing"]
    assert "typing" in CALLED["sitting"]
    assert not {"looking at robot", "reading", "pulling"} & set(CHOICE_LABELS)
    assert len(CHOICE_LABELS) == len(ACTIONS) - 7
    assert outcome_of_action(None, "walking") == "unknown"
