"""What the second path finds at the end of chains, at events and over time, in worlds to work out by hand."""

import pytest
from readings import EASY, HARD, RULES, World, ask, at_t0, toward

from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, SAME_GROUP
from jrdb_avr.schema.rules import LoadRules, Rules

SECONDS = range(15, 601, 15)
EVERY = range(0, 601)
PHONING, SITTING = at_t0(action="talking on the phone"), at_t0(action="sitting")


def boxes(outcome, decisive=None):
    """(node, track, frame) of the needed boxes, or of those that decide or do not."""
    return [(n.node, n.track, n.frame) for n in outcome.needed if decisive in (None, n.decisive)]


def in_a_row(*poses, frames=SECONDS, hidden=(), **more):
    """People 0, 1, ... from left to right, 20 degrees apart, with these poses; the first one phones."""
    world = World(frames)
    for track, pose in enumerate(poses):
        acts = [pose, "talking on the phone"] if track == 0 else [pose]
        seen = None if track in hidden else "Fully_visible"
        world.see(track, frames, acts, x=toward(100 + 20 * track), occlusion=seen, **more)
    return world


# -- chains at one time ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("relations", "outcome"),
    [
        ([FIRST_RIGHT, FIRST_LEFT], "empty"),  # back to the first
        ([FIRST_LEFT, FIRST_RIGHT], "empty"),  # nobody there
        ([FIRST_RIGHT, SAME_GROUP], "ambiguous"),
        ([SAME_GROUP, FIRST_RIGHT], "ambiguous"),
        ([FIRST_RIGHT, "conversation"], "unknown"),  # nobody's interactions were read
    ],
)
def test_steps_that_lead_to_no_one_person(relations, outcome):
    row = in_a_row("standing", "standing", "sitting", "walking", group=7)
    found = ask(row, "two_hop", [PHONING], [15], relations=relations)
    assert found.outcome == outcome and found.answer is None


def test_everybody_on_the_way_must_be_seen():
    row = in_a_row("standing", "standing", "sitting")
    row.see(3, [15], x=toward(90), occlusion="Fully_occluded")
    found = ask(row, "two_hop", [PHONING], [15], relations=[SAME_GROUP, FIRST_RIGHT])
    assert found.outcome == "unknown"  # nobody has a group
    row = in_a_row("standing", "standing", "sitting", hidden=[1]).list([0, 1, 2], [15]).join(0, 1, [15], "hugging")
    found = ask(row, "two_hop", [PHONING], [15], relations=["hugging", FIRST_RIGHT])
    assert found.answer == "sitting" and found.faults == ("b is not in clear view at frame 15",)


# -- joins ----------------------------------------------------------------------------------------------------------

LEFT_60, RIGHT_60 = (f"within 60 degrees to the {side} of (robot view)" for side in ("left", "right"))
BRANCHES = ("conversation", "hugging", RIGHT_60, LEFT_60)


def fork(*degrees, first=300, pose="sitting"):
    """a phones, talking to b in direction 100 and hugging c in direction 180; others stand in these directions."""
    world = World(SECONDS)
    for track, (angle, action) in enumerate(((first, "talking on the phone"), (100, "typing"), (180, "typing"))):
        world.see(track, SECONDS, ["standing", action], x=toward(angle))
    for track, angle in enumerate(degrees, start=3):
        world.see(track, SECONDS, [pose], x=toward(angle))
    return world.list(range(8), [15]).join(0, 1, [15], "conversation").join(0, 2, [15], "hugging")


def join(world, relations=BRANCHES):
    return ask(world, "fork_join", [PHONING], [15], relations=relations)


def test_a_join_needs_both_branches():
    assert join(fork(140, 110)).faults == (f"{LEFT_60!r} of c alone leads to d",)
    assert join(fork(140, 170)).faults == (f"{RIGHT_60!r} of b alone leads to d",)


def test_branches_stand_in_the_order_of_their_relations():
    found = join(fork(140, 110, 170), ("hugging", "conversation", LEFT_60, RIGHT_60))
    assert found.answer == "sitting"
    assert found.faults == ("the branches begin alike, or are not in the order of their relations",)


# -- later ----------------------------------------------------------------------------------------------------------


def later(change=300, pose="walking", **more):
    """a phones beside c, who sits until the frame `change`."""
    world = in_a_row("standing", "standing", **more)
    return world.see(2, range(15, change, 15), ["sitting"], x=toward(140)).see(
        2, range(change, 601, 15), [pose], x=toward(140)
    )


def test_a_later_action_is_another_one_at_least_ten_seconds_later():
    def found(t1, world=None):
        return ask(world or later(), "later_action", [PHONING], [15, t1], relations=[FIRST_RIGHT] * 2)

    assert (found(315).answer, found(315).target, found(315).faults) == ("walking", 2, ())
    assert boxes(found(315)) == [("a", 0, 15), ("b", 1, 15), ("c", 2, 15), ("c", 2, 315)]
    assert boxes(found(315), decisive=True) == [("c", 2, 315)]
    assert found(165, later(120)).faults == ()
    assert found(150, later(120)).faults == ("frame 150 is less than 10 s after frame 15",)
    assert found(270).faults == ("'sitting' is not certainly false at frame 15",)


def searched(first=200, last=300, turn=21.0, hard=(), t0_angle=140.0, frames=EVERY):
    """a stands, phoning; c is two to the right and types in [first, last], seen `turn` degrees farther from t0 on."""
    world = in_a_row("standing", "standing", frames=frames)
    for frame in frames:
        extra = ["typing"] if first <= frame <= last else [("typing", HARD)] if frame in hard else []
        world.see(2, [frame], ["standing", *extra], x=toward((t0_angle + (turn if frame > 15 else 0)) % 360))
    return world


def search(world, t0=15):
    return ask(world, "action_search", [PHONING], [t0], "typing", relations=[FIRST_RIGHT] * 2)


def test_whoever_is_searched_for_moves_and_starts_later():
    stays = "the person has moved by no more than 20 degrees"
    assert search(searched(turn=20.0)).faults == (stays,)
    assert search(searched(turn=20.1)).faults == ()
    assert search(searched(turn=-20.1)).faults == ()
    assert search(searched(first=45, last=100)).faults == ()
    soon = search(searched(first=44, last=100))
    assert soon.faults == ("frame 44 is less than 2 s after frame 15",)
    assert search(searched(hard=[100])).outcome == "unknown"
    assert search(searched(first=0, last=100)).outcome == "unknown"
    assert search(searched(first=700)).outcome == "empty"


# -- what comes next ------------------------------------------------------------------------------------------------


def sits_then(pose="walking", until=300, frames=EVERY, gap=(), hard=()):
    """1 sits, phoning at first, until a frame and then does something else; 9 stands all the time."""
    world = World(frames).see(9, frames, x=100)
    for frame in frames:
        if frame in gap:
            continue
        does = ("sitting" if frame <= until else pose, HARD if frame in hard else EASY)
        world.see(1, [frame], [does, *(["talking on the phone"] if frame < 30 else [])])
    return world


def consequence(world, conditions=(PHONING,), t0=15):
    return ask(world, "consequence", conditions, [t0], choices=("walking", "standing", "cycling", "lying down"))


def test_consequence_has_rules():
    assert consequence(sits_then(until=165)).faults == ()
    assert consequence(sits_then(until=164)).faults == ("frame 150 is less than 10 s after frame 15",)
    assert consequence(sits_then(), [SITTING]).faults == ("the question's words state or imply the choice 'cycling'",)


# -- gaps -----------------------------------------------------------------------------------------------------------


def busy(first=100, second=200, frames=EVERY):
    """1 sits; types from one frame on for four seconds, and phones from another on; 9 stands."""
    world = World(frames).see(9, frames, x=100)
    for frame in frames:
        acts = ["typing"] * (first <= frame < first + 60) + ["talking on the phone"] * (second <= frame < second + 60)
        world.see(1, [frame], ["sitting", *acts])
    return world


def between(world, actions=("typing", "talking on the phone")):
    return ask(world, "gap_starts", [SITTING], [15], actions=actions)


def test_seconds_between_two_starts_have_rules():
    assert between(busy(60, 135)).faults == ()
    assert between(busy(60, 134)).faults == ("less than 5 s lie between the events",)
    assert between(busy(59, 200)).faults == ("frame 59 is less than 3 s after frame 15",)
    other = between(busy(), ("talking on the phone", "typing"))
    assert "the two actions start in the other order" in other.faults
    assert between(busy(second=700)).outcome == "empty"
    assert between(busy(second=0)).outcome == "unknown"


def away(leaves=100, returns=300, frames=EVERY, hidden=(), unread=(), w=50):
    """1 sits and is not there between two frames; 9 stands."""
    known = [frame for frame in frames if frame not in unread]
    world = World(known).see(9, known, x=100)
    for frame in known:
        if frame <= leaves or frame >= returns:
            world.see(1, [frame], ["sitting"], occlusion="Fully_occluded" if frame in hidden else "Fully_visible", w=w)
    return world


def absence(world):
    return ask(world, "gap_absence", [SITTING], [15])


def test_an_absence_has_rules():
    assert absence(away(60, 135)).faults == ()
    assert absence(away(60, 134)).faults == ("less than 5 s lie between the events",)
    assert absence(away(59)).faults == ("frame 59 is less than 3 s after frame 15",)
    assert absence(away(hidden=[300])).faults == ("the person is not in clear view at frame 300",)
    assert absence(away(hidden=[100])).faults == ("the person is not in clear view at frame 100",)
    assert absence(away(hidden=[90])).outcome == "unknown"  # not present at a keyframe before
    assert absence(away(hidden=[91])).faults == ()
    assert absence(away(returns=700)).outcome == "empty"
    assert absence(away(leaves=700)).outcome == "empty"
    assert absence(away(unread=[200])).outcome == "unknown"
    # Fifteen frames without a box hold no keyframe at which both neighbours are without one too.
    assert absence(away(100, 116)).outcome == "empty"


# -- counts ---------------------------------------------------------------------------------------------------------

TYPING = Condition(action="typing", at="t1")


def company(meets, frames=SECONDS, unlisted=(), people=6, hidden=(), degree=None):
    """0 types; others meet it at the frames given by track; the lists of all are read, but for some (track, frame)."""
    world = World(frames)
    for track in range(people):
        for frame in frames:
            seen = degree if (track, frame) in hidden else "Fully_visible"
            acts = ["standing", "typing"] if track == 0 else ["standing"]
            world.see(track, [frame], acts, x=100 + 300 * track, occlusion=seen)
            if (track, frame) not in unlisted:
                world.list([track], [frame])
    for track, when in meets.items():
        world.join(0, track, [frame for frame in when if frame in frames])
    return world


def count(world, t1=15, t2=165, relation="conversation", rules=RULES):
    return ask(world, "gap_count", [TYPING], [t1, t2], relations=[relation], rules=rules)


FOUR = {1: [15], 2: [60, 75], 3: [165], 5: [15]}


def test_those_counted_are_shown_where_both_are_seen():
    found = count(company(FOUR, hidden=[(2, 60)]))
    assert ("b2", 2, 75) in boxes(found) and ("a", 0, 75) in boxes(found) and found.faults == ()
    found = count(company(FOUR, hidden=[(3, 165)]), rules=Rules(load=LoadRules(visibility="any")))
    assert found.faults == ("person 3, who is counted, is never in clear view together with the target",)


def test_a_count_has_rules():
    assert count(company({1: [15], 2: [60], 3: [165]})).faults == ("only 3 people are to be counted",)
    assert "frame 150 is less than 10 s after frame 15" in count(company(FOUR), t2=150).faults
    # Somebody who may or may not have been met at another time makes the number unknown; met for certain, they do not.
    assert count(company(FOUR, unlisted=[(4, 60)])).outcome == "unknown"
