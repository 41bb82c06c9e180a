"""The choices of questions about actions, as the second path judges them, in a world to work out by hand."""

import pytest
from readings import HARD, World, ask, at_t0

from jrdb_avr.schema.labels import choice_text

SECONDS = range(15, 601, 15)
SITTING = at_t0(action="sitting")
CHOICES = ("holding something", "lying down", "standing", "talking to someone")


def holder(lists=(), covered=(), partial=()):
    """1 sits at frame 15, then walks, and holds something from 120 on; `lists` has its labels at other frames."""
    world = World(SECONDS).see(9, SECONDS, ["running"], x=100)
    for frame in SECONDS:
        usual = ["sitting"] if frame == 15 else ["walking", "holding sth"] if frame >= 120 else ["walking"]
        labels = dict(lists).get(frame, usual)
        world.see(1, [frame], labels, occlusion="Fully_occluded" if frame in covered else "Fully_visible")
        world.rows["boxes_2d"][-1]["has_actions"] &= frame not in partial
    return world


def held(choices=CHOICES, frame=150, **world):
    return ask(holder(**world), "change", [SITTING], [15, frame], choices=choices)


def test_a_question_whose_choices_obey_every_rule():
    outcome = held()
    assert (outcome.outcome, outcome.answer, outcome.faults) == ("defined", "holding sth", ())


WALKS, STANDS = ["walking"], ["standing", "holding sth"]


@pytest.mark.parametrize(
    ("lists", "faults"),
    [
        ({135: WALKS}, 0),
        ({165: WALKS}, 0),
        ({135: WALKS, 165: WALKS}, 1),
        ({135: WALKS, 165: ["walking", ("holding sth", HARD)]}, 1),
        ({135: WALKS, 165: ["walking", "typing"]}, 1),  # typing is holding, for choices, but another label
    ],
)
def test_the_true_choice_is_certain_a_second_before_or_after(lists, faults):
    found = held(lists=lists).faults
    assert found == ("'holding sth' is not certain one second before or after frame 150",) * faults


TALKS = ["walking", "holding sth", ("talking to someone", HARD)]


@pytest.mark.parametrize(
    ("lists", "refused"),
    [
        ({frame: labels}, choice if apart <= reach else None)
        for labels, choice, reach in ((TALKS, "talking to someone", 3), (STANDS, "standing", 1))
        for apart in (1, 3, 4)
        for frame in (150 - 15 * apart, 150 + 15 * apart)
        if frame >= 120 or labels is TALKS
    ]
    + [
        ({150: ["walking", "holding sth", "listening to someone"]}, "talking to someone"),
        ({150: ["walking", "holding sth", ("listening to someone", HARD)]}, "talking to someone"),
        ({150: ["walking", "holding sth", "eating sth"]}, None),
    ],
)
def test_a_false_choice_is_false_at_the_time_and_without_a_label_around_it(lists, refused):
    fault = f"the choice {refused!r} is not certainly false around frame 150"
    assert held(lists=lists).faults == ((fault,) if refused else ())


@pytest.mark.parametrize(
    ("choices", "fault"),
    [
        ((*CHOICES[:3], "cycling"), "the question's words state or imply the choice 'cycling'"),
        ((*CHOICES[:3], "reading"), "'reading' may not be a choice"),
        ((*CHOICES[:3], "juggling"), "'juggling' may not be a choice"),
        ((*CHOICES[:3], "eating something"), "the choices 'holding sth' and 'eating sth' may be called the same"),
        (
            ("holding something", "listening to someone", "talking to someone", "lying down"),
            "the choices 'listening to someone' and 'talking to someone' may be called the same",
        ),
        (CHOICES[:3], "there are not 4 different choices"),
        ((*CHOICES, "skating"), "there are not 4 different choices"),
        ((*CHOICES[:3], "standing"), "there are not 4 different choices"),
        (("Holding something", "holding something", *CHOICES[1:3]), "'Holding something' may not be a choice"),
    ],
)
def test_choices_that_are_refused(choices, fault):
    assert fault in held(choices).faults


def test_one_choice_is_true():
    assert held(("walking", *CHOICES[:3])).outcome == "ambiguous"
    assert held(("skating", *CHOICES[1:])).outcome == "unknown"
    assert held(lists={150: ["walking", ("holding sth", HARD)]}).outcome == "unknown"


@pytest.mark.parametrize(
    ("labels", "faults"), [(["sitting", "holding sth"], 1), (["sitting", "typing"], 1), (["sitting"], 0)]
)
def test_the_answer_is_false_at_the_description(labels, faults):
    assert held(lists={15: labels}).faults == ("'holding sth' is not certainly false at frame 15",) * faults


@pytest.mark.parametrize(
    ("label", "occlusion", "fine"),
    [
        ("lying", "Fully_visible", True),
        (("lying", HARD), "Fully_visible", False),
        ("lying", "Severely_occluded", False),
        ("lying", None, False),
    ],
)
def test_each_choice_is_true_of_a_person_in_clear_view_somewhere(label, occlusion, fine):
    world = holder().show([label], occlusion)
    shown = [choice for choice in CHOICES if choice != choice_text("lying")]
    found = ask(world, "change", [SITTING], [15, 150], choices=CHOICES, shown=shown)
    assert found.faults == (() if fine else ("no person in clear view is certainly 'lying' at any keyframe",))
