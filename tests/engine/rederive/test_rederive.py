"""The second path on worlds small enough to work out by hand."""

import msgspec
import pytest
from readings import HARD, RULES, World, ask, at_t0

from jrdb_avr.engine.rederive import rederive
from jrdb_avr.schema.rules import LoadRules, Rules
from jrdb_avr.schema.templates import TEMPLATES, Slots

SITTING, STANDING, READING = at_t0(action="sitting"), at_t0(action="standing"), at_t0(action="reading")
EVERY = range(0, 601)
SECONDS = range(15, 601, 15)


# -- facts --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "clear"),
    [
        ({}, True),
        ({"occlusion": "Mostly_visible"}, True),
        ({"occlusion": "Severely_occluded"}, False),
        ({"occlusion": None}, False),
        ({"no_eval": True}, False),
        ({"w": 12, "h": 40}, True),
        ({"w": 11.9}, False),
        ({"h": 39.9}, False),
        ({"w": 480}, True),
        ({"w": 480.1}, False),
        ({"y": -0.1}, False),
        ({"y": 330}, True),
        ({"y": 330.1}, False),
        ({"x": 3740}, True),
        ({"x": -20}, True),
    ],
)
def test_a_clear_view(change, clear):
    assert World(SECONDS).see(2, [15], x=100).see(1, [15], **change).read().clear(1, 15) is clear


# -- whom a description means -------------------------------------------------------------------------------------


def test_a_description_means_one_person_for_certain():
    def find(*others):
        world = World(SECONDS).see(0, [15], ["sitting"])
        for track, actions in enumerate(others, start=1):
            world.see(track, [15], actions)
        return world.read().find((SITTING,), 15)

    assert find(["standing"]) == ("defined", 0)
    assert find(["sitting"]) == ("ambiguous", None)
    assert find([("sitting", HARD)]) == ("unknown", None)
    assert find(None) == ("unknown", None)
    nobody = World(SECONDS).see(0, [15]).read()
    assert nobody.find((SITTING,), 15) == ("empty", None)
    assert nobody.find((SITTING,), 16) == ("unknown", None)  # a frame that nobody labelled
    # The others count however badly they are seen, unless they are covered.
    hidden = (
        World(SECONDS).see(0, [15], ["sitting"]).see(1, [15], ["sitting"], occlusion="Fully_occluded", no_eval=True)
    )
    any_view, clear_view = (Rules(load=LoadRules(visibility=value)) for value in ("any", "clear"))
    assert hidden.read(any_view).find((SITTING,), 15) == ("ambiguous", None)
    assert hidden.read(clear_view).find((SITTING,), 15) == ("defined", 0)


def test_each_condition_is_needed():
    world = World(SECONDS).see(0, SECONDS, ["sitting", "reading"]).see(1, SECONDS, ["standing", "reading"])
    assert ask(world, "presence", [SITTING], [15, 60, 105]).faults == ()
    outcome = ask(world, "presence", [SITTING, READING], [15, 60, 105])
    assert "the description has a condition too many" in outcome.faults
    alone = World(SECONDS).see(0, SECONDS, ["sitting"])
    assert "the description has a condition too many" in ask(alone, "presence", [SITTING], [15, 60, 105]).faults


# -- change -------------------------------------------------------------------------------------------------------


PHONING = at_t0(action="talking on the phone")


def walk_in():
    world = World(SECONDS).see(9, SECONDS, ["standing"], x=100)
    return world.see(1, [15, 30, 45], ["sitting", "talking on the phone"]).see(1, [60, 75], ["walking"])


def test_change_reads_the_action():
    outcome = ask(walk_in(), "change", [PHONING], [15, 75])
    assert (outcome.outcome, outcome.answer, outcome.target, outcome.faults) == ("defined", "walking", 1, ())
    assert outcome.times == (("t0", 15), ("t1", 75))
    assert [(n.track, n.frame, n.decisive) for n in outcome.needed] == [(1, 15, False), (1, 75, True)]


@pytest.mark.parametrize(
    ("conditions", "times", "said"),
    [
        ([PHONING], [15, 45], "less than 3 s"),
        ([SITTING], [15, 75], "imply the choice 'sitting'"),
        ([PHONING], [30, 45], "not certainly false at frame 30"),
        ([PHONING], [15, 61], "frame 61 is not a keyframe"),
    ],
)
def test_change_has_rules(conditions, times, said):
    world = walk_in().see(1, [61], ["walking"])
    assert any(said in fault for fault in ask(world, "change", conditions, times).faults)


def test_change_of_an_unknown_action():
    world = walk_in().see(1, [90], [("walking", HARD)])
    assert ask(world, "change", [PHONING], [15, 90]).outcome == "unknown"
    assert ask(walk_in(), "change", [PHONING], [15, 90]).outcome == "unknown"  # gone, but seen at 75
    assert ask(walk_in(), "change", [PHONING], [15, 105]).outcome == "empty"
    assert ask(walk_in(), "change", [PHONING], [15, 75], choices=()).outcome == "unknown"


def test_needed_boxes_are_clear_and_have_images():
    world = walk_in().see(1, [90], ["walking"], occlusion=None)
    assert "the person is not in clear view at frame 90" in ask(world, "change", [PHONING], [15, 90]).faults
    world = walk_in()
    world.images = [15, 30]
    assert ask(world, "change", [PHONING], [15, 75]).faults == ("frame 75 has no image",)


# -- presence and distance ----------------------------------------------------------------------------------------


def test_presence():
    def answer(first, second, world=None):
        world = world or World(SECONDS).see(9, SECONDS, x=100).see(1, [15, 90, 105], ["sitting"])
        return ask(world, "presence", [SITTING], [15, first, second])

    assert answer(90, 195).answer == "only at the first time"
    assert answer(60, 105).outcome == "defined" and answer(60, 105).answer == "only at the second time"
    assert answer(150, 210).answer == "neither time"
    assert answer(120, 195).outcome == "unknown"  # seen a second before
    both = World(SECONDS).see(9, SECONDS, x=100).see(1, SECONDS, ["sitting"])
    assert answer(60, 105, both).answer == "both times"
    assert answer(60, 105, both).faults == ()
    assert answer(45, 105, both).faults == ("frame 45 is less than 3 s after frame 15",)
    assert answer(60, 90, both).faults == ("frame 90 is less than 3 s after frame 60",)
    assert [(n.frame, n.decisive) for n in answer(150, 210).needed] == [(15, True)]
    assert [(n.frame, n.decisive) for n in answer(90, 195).needed] == [(15, False), (90, True)]
    hidden = World(SECONDS).see(9, SECONDS, x=100).see(1, SECONDS, ["sitting"])
    hidden.rows["boxes_2d"][SECONDS.index(60) + len(SECONDS)]["occlusion"] = "Fully_occluded"
    assert answer(60, 105, hidden).outcome == "unknown"


def test_a_one_keyframe_gap_and_the_end_of_the_labels_are_no_absence():
    seen = [frame for frame in SECONDS if frame not in (90, 585, 600)]
    world = World(SECONDS).see(9, SECONDS, x=100).see(1, seen, ["sitting"])
    annotations = world.read()
    assert not annotations.absent(1, 90) and not annotations.absent(1, 585) and not annotations.absent(1, 600)


@pytest.mark.parametrize(
    ("metres", "answer"),
    [(8.5, "closer to the robot"), (8.51, None), (9.5, None), (9.51, "about the same distance"),
     (10.49, "about the same distance"), (10.5, None), (11.5, "farther from the robot"),
     (14, "farther from the robot")],
)  # fmt: skip
def test_distance(metres, answer):
    world = World(SECONDS).see(9, SECONDS, x=100).see(1, [15], ["sitting"], at=(10.0, 0.0))
    world.see(1, [60], ["walking"], at=(0.0, -metres))
    outcome = ask(world, "distance", [SITTING], [15, 60])
    assert (outcome.answer, outcome.outcome) == (answer, "defined" if answer else "unknown")


# -- start and span -----------------------------------------------------------------------------------------------


def phone_call(step, on, hard=(), missing=(), occluded=()):
    """A standing person who reads at the frames `on`; another one walks about all the time."""
    frames = EVERY if step == 1 else SECONDS
    world = World(frames).see(9, frames, ["walking"], x=100)
    for frame in frames:
        if frame in missing:
            continue
        extra = ["reading"] if frame in on else [("reading", HARD)] if frame in hard else []
        world.see(
            1, [frame], ["standing", *extra], occlusion="Fully_occluded" if frame in occluded else "Fully_visible"
        )
    return world


def start(world, t0=15):
    return ask(world, "start", [STANDING], [t0], "reading")


def span(world, t0=15):
    return ask(world, "span", [STANDING], [t0], "reading")


def test_start_and_span_at_fifteen_frames_per_second():
    world = phone_call(1, range(100, 200))
    assert start(world).answer == '{"frame":100}'
    outcome = span(world)
    assert outcome.answer == '{"start_frame":100,"end_frame":199}'
    assert outcome.faults == () and outcome.times == (("t0", 15), ("t1", 100), ("t2", 199))
    assert [(n.frame, n.decisive) for n in outcome.needed] == [(15, False), (100, True), (199, True)]


def test_the_first_time_after_is_the_first_that_is_not_certainly_false():
    world = phone_call(1, [*range(100, 160), *range(300, 400)])
    assert start(world).answer == '{"frame":100}'
    assert start(world, t0=165).answer == '{"frame":300}'
    assert start(world, t0=150).outcome == "unknown"  # reading at t0
    assert start(world, t0=450).outcome == "empty"
    assert start(phone_call(1, range(100, 200), hard=[40])).outcome == "unknown"
    assert start(phone_call(1, range(100, 200), hard=[15])).outcome == "unknown"
    assert start(phone_call(1, range(100, 200), hard=[40]), t0=45).answer == '{"frame":100}'


def test_keyframes():
    assert World([3, 18, 33]).see(1, [3]).read().keyframes == {3, 18, 33}
    assert World(range(3, 40)).see(1, [3]).read().keyframes == {15, 30}
    # A frame with boxes that the 2D layer does not vouch for: somebody there could not be read.
    world = World([15, 45]).see(1, [15, 30])
    world.action_frames = {15, 30, 45}
    assert world.read().keyframes == {15, 45}


def test_plans_that_cannot_be_read():
    world = walk_in()
    plan = TEMPLATES["change"].build(Slots((READING,), {"t0": 15, "t1": 60}))
    plan = msgspec.structs.replace(plan, times={"t0": plan.times["t1"], "t1": plan.times["t0"]})
    assert rederive(world.read(), plan, "change", RULES).outcome != "defined"
