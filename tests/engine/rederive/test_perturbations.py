"""What the second path finds of every perturbation of a plan, in worlds to work out by hand."""

import pytest
from readings import CHOICES, EASY, HARD, RULES, World, at_t0, toward

from jrdb_avr.engine.rederive import prove_again, rederive
from jrdb_avr.schema.relations import FIRST_RIGHT
from jrdb_avr.schema.templates import TEMPLATES, Slots

SECONDS = range(15, 601, 15)
READING = at_t0(action="reading")


def proofs(world, form, frames, relations=(), actions=(), conditions=(READING,)):
    """(kind, variant) -> (outcome, answer) of every proof of a question; what holds is checked here."""
    row = TEMPLATES[form]
    times = dict(zip(row.stated, frames, strict=True))
    plan, annotations = row.build(Slots(conditions, times, tuple(actions), tuple(relations))), world.read()
    own = rederive(annotations, plan, row.name, RULES, CHOICES)
    assert own.outcome == "defined", own
    found = {}
    for proof in prove_again(annotations, plan, row.name, RULES, own):
        if proof.kind not in ("anchor", "evidence", "rederive", "view.single", "view.ahead"):
            proves = proof.outcome in ("different", "ambiguous", "empty")
            assert proof.holds is (None if proof.outcome == "not_run" else proves)
        found[proof.kind, proof.variant] = (proof.outcome, proof.answer)
    return found


def row_of(*poses, changed=(), at=(), **more):
    """People 0, 1, ... from left to right, 20 degrees apart, with these poses, those of `changed` at the frames `at`.

    The first one reads.
    """
    world = World(SECONDS)
    for frame in SECONDS:
        for track, pose in enumerate(changed if frame in at else poses):
            acts = pose if isinstance(pose, list) else [pose, "reading"] if track == 0 else [pose]
            if pose is not None:
                world.see(track, [frame], acts, x=toward(100 + 20 * track), **more)
    return world


# -- other times ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("then", "outcome"),
    [
        (("standing", "standing", "walking"), ("different", None)),
        (("walking", "bending", "sitting"), ("same", "sitting")),
        (("standing", "standing", ["walking", "standing"]), ("unknown", None)),  # two poses
        ((["standing"], "standing", "sitting"), ("empty", None)),  # nobody reads
        (("standing", ["standing", "reading"], "sitting"), ("ambiguous", None)),
        (([("reading", HARD)], "standing", "sitting"), ("unknown", None)),
        (("standing", "standing", None), ("empty", None)),  # the second hop leads nowhere
    ],
)
def test_the_whole_program_moves(then, outcome):
    world = row_of("standing", "standing", "sitting", changed=then, at=[105])
    found = proofs(world, "two_hop", [60], [FIRST_RIGHT] * 2)
    assert found["time.shift", "+3 s"] == outcome
    assert found["time.shift", "-3 s"] == ("same", "sitting")
    assert found["time.drop", "all keyframes"] == ("different" if outcome[0] == "different" else "same", None)


def test_a_program_without_an_answer_elsewhere_needs_its_time():
    world = row_of("standing", "standing", None, changed=("standing", "standing", "sitting"), at=[60])
    found = proofs(world, "two_hop", [60], [FIRST_RIGHT] * 2)
    assert found["time.drop", "all keyframes"] == ("empty", None)


def test_a_shift_out_of_the_sequence_or_to_no_keyframe():
    world = row_of("standing", "standing", "sitting")
    found = proofs(world, "two_hop", [45], [FIRST_RIGHT] * 2)
    assert found["time.shift", "-3 s"] == ("outside", None) and found["time.shift", "+3 s"] == ("same", "sitting")
    assert proofs(world, "two_hop", [570], [FIRST_RIGHT] * 2)["time.shift", "+3 s"] == ("outside", None)
    world = row_of("standing", "standing", "sitting")
    world.action_frames.remove(105)
    assert proofs(world, "two_hop", [60], [FIRST_RIGHT] * 2)["time.shift", "+3 s"] == ("unknown", None)


def lone(poses, **more):
    """Person 1 reads at frame 15 and has these poses by frame; somebody else walks all the time."""
    world = World(SECONDS).see(9, SECONDS, ["walking"], x=100).see(1, [15], ["standing", "reading"], at=(9.0, 0.0))
    for frame, pose in poses.items():
        world.see(1, [frame], pose, **more)
    return world


@pytest.mark.parametrize(
    ("pose", "outcome"),
    [
        (["walking"], ("different", None)),
        (["sitting"], ("same", "sitting")),
        ([("walking", HARD)], ("unknown", None)),
        (None, ("empty", None)),
    ],
)
def test_the_person_is_held_where_a_later_time_moves(pose, outcome):
    poses = {60: ["sitting"]} if pose is None else {60: ["sitting"], 105: pose}
    found = proofs(lone(poses), "change", [15, 60])
    assert found["time.shift", "+3 s"] == outcome
    assert found["time.shift", "-3 s"] == ("outside", None)  # to the description's time
    drop = {"different": "different", "same": "same"}.get(outcome[0], "empty")
    assert found["time.drop", "all keyframes"] == (drop, None)


def test_both_times_of_a_presence_move_and_keep_apart():
    poses = {frame: ["standing"] for frame in (*range(30, 121, 15), 300, 315)}
    found = proofs(lone(poses), "presence", [15, 120, 210])
    assert found["time.shift", "-3 s"] == ("same", "only at the first time")
    assert found["time.shift", "+3 s"] == ("different", "neither time")
    assert found["time.drop", "all keyframes"] == ("different", None)
    found = proofs(lone(poses), "presence", [15, 120, 570])
    assert found["time.shift", "+3 s"] == ("outside", None)
    assert found["time.shift", "-3 s"] == ("same", "only at the first time")


@pytest.mark.parametrize(
    ("metres", "occlusion", "outcome"),
    [
        (6.0, "Fully_visible", ("different", "closer to the robot")),
        (12.0, "Fully_visible", ("same", "farther from the robot")),
        (12.0, "Severely_occluded", ("unknown", None)),  # whether in view or not
        (10.0, "Fully_visible", ("unknown", None)),  # neither much nor little
    ],
)
def test_a_distance_is_known_of_whoever_is_in_view(metres, occlusion, outcome):
    world = lone({60: ["standing"]}, at=(12.0, 0.0))
    world.see(1, [105], ["standing"], at=(metres, 0.0), occlusion=occlusion)
    found = proofs(world, "distance", [15, 60])
    assert found["time.shift", "+3 s"] == outcome
    # Nobody is there from frame 150 on.
    assert found["time.drop", "all keyframes"] == ("different", None)


# -- hops -----------------------------------------------------------------------------------------------------------


def test_a_chain_stopped_and_with_a_hop_left_out():
    world = row_of("standing", "walking", "lying", "sitting").list(range(4), [60])
    world.join(2, 3, [60], "hugging").join(0, 1, [60], "hugging")
    found = proofs(world, "three_hop", [60], [FIRST_RIGHT, FIRST_RIGHT, "hugging"])
    assert {key: outcome for key, outcome in found.items() if key[0].startswith("hop")} == {
        ("hop.stop", "0"): ("different", None),
        ("hop.stop", "1"): ("different", None),
        ("hop.stop", "2"): ("different", None),
        ("hop.skip", "1"): ("empty", None),  # the first to the right hugs the first person
        ("hop.skip", "2"): ("empty", None),
    }
    found = proofs(world, "three_hop", [60], [FIRST_RIGHT] * 3)
    assert found["hop.skip", "1"] == found["hop.skip", "2"] == ("different", None)


def starts(first, difficulty=HARD, *, last=None, turned=0.0, first_of_c=90):
    """At 1 Hz: c, two hops from the reading a, types from frame 90 on; b from `first` to `last`, and then stands
    `turned` degrees from where c is."""
    world = World(SECONDS)
    for frame in SECONDS:
        acts = [("typing", difficulty)] if first <= frame <= (last or first) else []
        world.see(0, [frame], ["standing", "reading"], x=toward(100))
        world.see(1, [frame], ["standing", *acts], x=toward(120 if frame == 15 else 200 + turned))
        world.see(2, [frame], ["standing", "typing"] if frame >= first_of_c else ["standing"],
                  x=toward(140 if frame == 15 else 200))  # fmt: skip
    return proofs(world, "action_search", [15], [FIRST_RIGHT] * 2, ["typing"])["hop.stop", "1"][0]


@pytest.mark.parametrize(
    ("first", "outcome"),
    [(60, "empty"), (75, "unknown"), (90, "unknown"), (105, "unknown"), (120, "empty")],
)
def test_a_start_that_may_score_is_unknown_until_the_keyframe_after_the_targets(first, outcome):
    # The stored start is frame 83, half a step before the keyframe; one at frame 105 is stored as 98 and scores.
    assert starts(first) == outcome
    assert starts(first, turned=21.0) == "empty"
    certain = starts(first, EASY, last=600)
    assert certain == ("same" if outcome == "unknown" else "different")


def test_an_action_that_goes_on_starts_nowhere():
    assert starts(15, EASY, last=600) == "empty"


# -- forks ----------------------------------------------------------------------------------------------------------

LEFT_60, RIGHT_60 = (f"within 60 degrees to the {side} of (robot view)" for side in ("left", "right"))
BRANCHES = ("conversation", "hugging", RIGHT_60, LEFT_60)


BETWEEN = ((140, "sitting"), (110, "lying"), (170, "lying"))


def fork(*, hugs=SECONDS, talks=SECONDS, others=BETWEEN):
    """a reads in direction 300, talks to b in direction 100 and hugs c in direction 180; `others` stand between."""
    world = World(SECONDS)
    for track, (angle, acts) in enumerate(((300, ["standing", "reading"]), (100, ["walking"]), (180, ["lying"]))):
        world.see(track, SECONDS, acts, x=toward(angle))
    for track, (angle, pose) in enumerate(others, start=3):
        world.see(track, SECONDS, [pose], x=toward(angle))
    world.list(range(8), SECONDS).join(0, 1, talks, "conversation").join(0, 2, hugs, "hugging")
    return world


def test_no_hop_of_a_fork_can_be_left_out():
    found = proofs(fork(), "fork_join", [60], BRANCHES)
    assert {key: outcome for key, outcome in found.items() if key[0].startswith("hop")} == {
        ("hop.stop", "0"): ("different", None),
        ("hop.stop", "1"): ("different", None),
        ("hop.stop", "2"): ("different", None),
        ("hop.skip", "1"): ("empty", None),  # to the right of a there is nobody to the left of c
        ("hop.skip", "2"): ("empty", None),
        ("hop.skip", "3"): ("ambiguous", None),
        ("hop.skip", "4"): ("ambiguous", None),
    }


def test_one_branch_that_leads_to_nobody_is_enough():
    # At frame 105 nobody is hugged, and with whom a talks is not known.
    world = fork(hugs=[60], talks=[60])
    world.join(0, 1, [105], ("conversation", HARD))
    found = proofs(world, "fork_join", [60], BRANCHES)
    assert found["time.shift", "+3 s"] == found["time.shift", "-3 s"] == ("empty", None)
    assert found["time.drop", "all keyframes"] == ("empty", None)


# -- descriptions and views -----------------------------------------------------------------------------------------


def test_a_condition_can_be_left_out_where_nobody_else_could_match():
    world = lone({60: ["sitting"]})
    needless = at_t0(action="standing")
    found = proofs(world, "change", [15, 60], conditions=(READING, needless))
    assert found["anchor", "without action standing"] == ("same", None)
    assert found["anchor", "without action reading"] == ("same", None)
    assert proofs(world, "change", [15, 60])["anchor", "without action reading"] == ("ambiguous", None)


@pytest.mark.parametrize(
    ("start", "end", "ahead", "single"),
    [
        (180, 180, True, True),
        (158, 158, True, True),
        (150, 150, False, True),
        (0, 180, True, False),
        (180, 0, False, False),
        (4, 356, False, True),
    ],
)
def test_what_one_view_shows(start, end, ahead, single):
    world = World(SECONDS).see(9, SECONDS, ["walking"], x=100)
    world.see(1, [15], ["standing", "reading"], x=toward(start)).see(1, [60], ["sitting"], x=toward(end))
    found = proofs(world, "change", [15, 60])
    assert found["view.ahead", "180"] == (("same", "sitting") if ahead else ("empty", None))
    assert found["view.single", "any angle"] == (("same", "sitting") if single else ("empty", None))
