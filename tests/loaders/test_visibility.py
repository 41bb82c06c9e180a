"""Who is in clear view: covered shares of boxes, classes, and what load makes of covered people."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from oracle_covering import hidden_share
from readings import HARD, World, intervals_of

from jrdb_avr.engine.rederive import FALSE, TRUE, UNKNOWN
from jrdb_avr.engine.rederive.covering import covered_area, outline_of
from jrdb_avr.loaders.intervals.visibility import UNIT, covered_areas
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import LoadRules, Rules, override

CLEAR = LoadRules(visibility="clear")
RULES = Rules(load=CLEAR)


def shares(boxes):
    """The covered share of each of the boxes of one frame, as load computes it; None of empty boxes."""
    covered, area = covered_areas(np.zeros(len(boxes), np.int64), np.array(boxes, float))
    return [Fraction(int(c), int(a)) if a > 0 else None for c, a in zip(covered, area, strict=True)]


def rows(world, kind="sightings", rules=CLEAR):
    return intervals_of(world, rules)[kind].to_pylist()


def views(world, rules=CLEAR):
    """{(track, frame): class}; the second program must agree."""
    found = {(row["track"], row["frame"]): _view(row) for row in rows(world, rules=rules)}
    second = world.read(Rules(load=rules))
    assert {key: second.view(*key) for key in found} == found
    return found


def _view(row):
    assert not (row["clear"] and row["covered"])
    return "clear" if row["clear"] else "covered" if row["covered"] else "uncertain"


# -- the covered share ------------------------------------------------------------------------------------------------

BEHIND = (1000, 100, 100, 200)
HALF = Fraction(1, 2)
SHARES = [
    ([BEHIND, (1050, 100, 100, 210)], [HALF, 0]),
    ([BEHIND, (1000, 200, 100, 200)], [HALF, 0]),  # from half of its height down
    ([BEHIND, (1000, 100, 50, 210), (1025, 100, 50, 220)], [Fraction(3, 4), HALF, 0]),  # what two cover counts once
    ([BEHIND, (1000, 100, 50, 210), (1050, 200, 50, 210)], [Fraction(3, 4), 0, 0]),
    ([BEHIND, (900, 0, 300, 400)], [1, 0]),
    ([BEHIND, (1050, 100, 100, 202)], [0, 0]),  # lower by 2 px is not nearer
    ([BEHIND, (1050, 100, 100, 202 + 1 / UNIT)], [HALF, 0]),
    ([BEHIND, (1100, 100, 100, 300)], [0, 0]),  # side by side
    ([BEHIND, (1050 + 3760, 100, 100, 300)], [HALF, 0]),  # the same column one turn later
    ([BEHIND, (1050 - 3760, 100, 100, 300)], [HALF, 0]),
    ([BEHIND, (1000, -100, 100, 800)], [1, 0]),  # cut to the picture
    ([BEHIND, (1000, 500, 100, 50)], [0, None]),  # below the picture
    ([BEHIND, (500, 100, 5000, 300)], [1, 0]),  # wider than the panorama
    # Both leave the picture: more than 4 px higher is nearer, from y = 478 on.
    ([(100, 200, 50, 280), (125, 195, 50, 285)], [HALF, 0]),
    ([(100, 200, 50, 280), (125, 196, 50, 284)], [0, 0]),
    ([(100, 200, 50, 278), (125, 190, 50, 288)], [HALF, 0]),
    ([(100, 200, 50, 277), (125, 300, 50, 180)], [Fraction(177, 554), 0]),
    ([(100, 200, 50, 277), (125, 300, 50, 179)], [0, 0]),
    ([(100, 200, 50, 400), (125, 300, 50, 180)], [0, HALF]),  # bottoms are those of the cut boxes
    ([(100, 490, 50, 40), (100, 100, 50, 200)], [None, 0]),  # an empty box covers nobody
    ([(100, 100, 0.001, 300), (100, 100, 50, 200)], [None, 0]),
]
SEAM = [
    ([(3740, 100, 40, 200), (0, 100, 40, 300)], [HALF, 0]),
    ([(-20, 100, 40, 200), (0, 100, 40, 300)], [HALF, 0]),
    ([(10, 100, 40, 200), (3750, 100, 40, 300)], [HALF, 0]),
]


@pytest.mark.parametrize(("boxes", "expected"), SHARES + SEAM)
def test_the_share_of_a_box_that_nearer_boxes_cover(boxes, expected):
    assert shares(boxes) == expected


EDGES = st.sampled_from((0, 1, 2, 3, 3758, 3759, 3760, 1879.5, 40, 44, -5))
LENGTHS = st.sampled_from((1, 2, 3, 4, 40, 44, 3760, 3759, 4000, 0.004, 0.001))
TOPS, HEIGHTS = st.sampled_from((-3, 0, 100, 104, 105, 400, 479, 480)), st.sampled_from((1, 2, 3, 76, 78, 80, 378, 600))
TIED = st.tuples(EDGES, TOPS, LENGTHS, HEIGHTS)
ANY = st.tuples(st.floats(-100, 8000), st.floats(-50, 520), st.floats(0.001, 900), st.floats(0.001, 600))


@given(st.lists(st.one_of(TIED, ANY), min_size=1, max_size=9))
@example([(3759, 100, 40, 200), (2, 100, 40, 210), (3760, 104, 3760, 378), (0, 100, 3760, 600)])
def test_three_programs_measure_the_same_share(boxes):
    expected = [hidden_share(box, [*boxes[:i], *boxes[i + 1 :]]) for i, box in enumerate(boxes)]
    assert shares(boxes) == expected
    outlines = [outline_of(Box(*box)) for box in boxes]
    for i, own in enumerate(outlines):
        area = covered_area(own, [*outlines[:i], *outlines[i + 1 :]]) if own.area > 0 else 0
        assert (Fraction(area, own.area) if own.area > 0 else None) == expected[i]


def test_frames_do_not_mix():
    boxes = np.array([BEHIND, (1000, 100, 100, 300)], float)
    assert covered_areas(np.array([3, 4]), boxes)[0].tolist() == [0, 0]


# -- classes ----------------------------------------------------------------------------------------------------------


def pair(width, **more):
    """Somebody 100 px wide behind somebody who covers this much of the width."""
    return World([0], attributes=False).see(1, [0], x=100, w=100, **more).see(2, [0], x=0, y=0, w=100 + width, h=300)


@pytest.mark.parametrize(
    ("width", "view"),
    [(0, "clear"), (49.99, "clear"), (50, "uncertain"), (79.99, "uncertain"), (80, "covered"), (100, "covered")],
)
def test_without_attributes_the_covered_share_decides(width, view):
    world = pair(width)
    assert views(world) == {(1, 0): view, (2, 0): "clear"}
    assert set(views(world, LoadRules(visibility="any")).values()) == {"clear"}
    assert rows(world, "sequence")[0]["visibility"] == "geometry"
    assert rows(world, "sequence", LoadRules(visibility="any"))[0]["visibility"] == "nothing"


@pytest.mark.parametrize("more", [{"h": 39}, {"y": -1}, {"no_eval": True}])
def test_what_was_no_clear_view_is_uncertain_unless_it_is_covered(more):
    assert [views(pair(width, **more))[1, 0] for width in (0, 60, 90)] == ["uncertain", "uncertain", "covered"]


def test_with_attributes_the_degree_of_occlusion_decides():
    world = World([0])
    degrees = ("Fully_visible", "Mostly_visible", "Severely_occluded", "Fully_occluded", None)
    for track, degree in enumerate(degrees):
        world.see(track, [0], x=100, occlusion=degree)
    world.see(9, [0], x=100, h=20, occlusion="Fully_occluded").see(10, [0], x=0, w=300, h=300)
    classes = ["clear", "clear", "covered", "covered", "uncertain", "covered", "clear"]
    assert [*views(world).values()] == classes
    assert rows(world, "sequence")[0]["visibility"] == "attributes"


def test_a_sequence_in_which_no_occlusion_can_be_read_is_judged_by_boxes():
    world = World([0]).see(1, [0], x=100, w=100, occlusion=None).see(2, [0], x=0, w=150, h=200, occlusion=None)
    assert views(world) == {(1, 0): "uncertain", (2, 0): "clear"}
    assert set(views(world, LoadRules(visibility="any")).values()) == {"uncertain"}


@pytest.mark.parametrize(
    ("labels", "clear"),
    [
        ({0: 7}, [*range(16)]),  # at most a second away
        ({0: (7, HARD)}, []),
        ({0: (7, None)}, []),
        ({0: 7, 10: (7, HARD)}, [*range(6)]),  # of two frames as far away the earlier one
        ({0: (7, HARD), 10: 7}, [*range(6, 26)]),
        ({0: None, 10: 7}, [*range(6, 26)]),  # only somebody else has a label there
    ],
)
def test_whoever_is_in_no_certain_group_is_not_clear(labels, clear):
    frames = range(40)
    world = World(frames, attributes=False)
    for frame in frames:
        world.see(1, [frame], x=100, group=labels.get(frame))
        world.see(2, [frame], x=1000, group=8 if frame in labels else None)
    world.group_frames = [*labels]
    found = views(world)
    assert [frame for frame in frames if found[1, frame] == "clear"] == clear
    assert {found[1, frame] for frame in frames} <= {"clear", "uncertain"}


@pytest.mark.parametrize(("least", "most"), [("0.5", "0.4"), ("0.9", "0.8")])
def test_a_person_cannot_be_clear_and_covered(least, most):
    with pytest.raises(InputError, match="min_covered is at least max_covered"):
        override(Rules(), {"load.max_covered": least, "load.min_covered": most})
    assert override(Rules(), {"load.max_covered": most, "load.min_covered": most}).load.min_covered == float(most)


# -- covered people ---------------------------------------------------------------------------------------------------

HIDDEN = {"occlusion": "Fully_occluded"}


def test_on_covered_frames_a_written_label_is_unknown_and_another_stays_false():
    world = World([0, 15], attributes=True).see(1, [0], ["walking", "reading"], **HIDDEN).see(1, [15], ["walking"])
    annotations = world.read(RULES)
    states = [annotations.state(1, action, 0) for action in ("walking", "reading", "sitting", "typing")]
    assert states == [UNKNOWN, UNKNOWN, FALSE, FALSE]
    assert [(row["frame"], row["pose"]) for row in rows(world)] == [(0, None), (15, "walking")]
    certain = {(row["action"], row["first"], row["last"]): row["certain"] for row in rows(world, "actions")}
    assert certain == {("reading", 0, 0): False, ("walking", 0, 0): False, ("walking", 15, 15): True}


SIZES = {
    "two clear members": ([{"group": 7}], (2, 2)),
    "nobody else": ([], (1, 1)),
    "a covered member counts for nobody": ([{"group": 7, **HIDDEN}], (1, 1)),
    "an uncertain member": ([{"group": 7, "occlusion": None}], (1, 2)),
    "a clear person of hard membership": ([{"group": (7, HARD)}], (1, 2)),
    "a hard member of another group": ([{"group": (8, HARD)}], (1, 2)),
    "no membership": ([{"group": None}], (1, 2)),
    "a covered person without membership": ([{"group": None, **HIDDEN}], (1, 1)),
    "another group": ([{"group": 8}, {"group": 8, "occlusion": None}], (1, 1)),
    "all of them": ([{"group": 7}, {"group": 7, "occlusion": None}, {"group": None}, {"group": 8}], (2, 4)),
}


@pytest.mark.parametrize("others", SIZES)
def test_a_group_has_its_clear_members_and_perhaps_the_uncertain_ones(others):
    people, (least, most) = SIZES[others]
    world = World([0]).see(1, [0], group=7)
    for track, person in enumerate(people, start=2):
        world.see(track, [0], x=100 * track, **person)
    row = rows(world)[0]
    assert (row["group_size_min"], row["group_size_max"]) == (least, most)
    assert row["group_size"] == (least if least == most else None)
    annotations = world.read(RULES)
    for size in range(1, 6):
        fact = TRUE if size == least == most else UNKNOWN if least <= size <= most else FALSE
        assert annotations.holds(Condition(attribute="group_size", value=size, at="t0"), 1, 0) == fact


@pytest.mark.parametrize(("partner", "fact"), [({}, TRUE), ({"occlusion": None}, UNKNOWN), (HIDDEN, UNKNOWN)])
def test_a_conversation_with_someone_needs_a_partner_in_clear_view(partner, fact):
    world = World([0]).see(1, [0]).see(2, [0], x=100, **partner).join(1, 2, [0]).list([1, 2], [0])
    assert world.read(RULES).holds(Condition(interaction="conversation", at="t0"), 1, 0) == fact
    assert world.read(Rules(load=LoadRules(visibility="any"))).interacts(1, "conversation", 0) == TRUE


@pytest.mark.parametrize(
    ("label", "other", "fact"),
    [
        ("looking at robot", "looking at robot", UNKNOWN),
        ("looking at robot", ("looking at robot", HARD), UNKNOWN),
        ("looking at sth", "looking at robot", FALSE),  # of its own label only
        ("reading", "reading", FALSE),
    ],
)
@pytest.mark.parametrize("when", [0, 30])
def test_a_label_that_flickers_is_unknown_beside_a_keyframe_that_has_it(label, other, fact, when):
    world = World([0, 15, 30]).see(1, [15], ["standing"]).see(1, [when], ["standing", other])
    assert world.read(RULES).holds(Condition(action=label, at="t0"), 1, 15) == fact
    assert world.read(RULES).state(1, label, 15) == FALSE
    assert world.read(Rules(load=LoadRules(visibility="any"))).holds(Condition(action=label, at="t0"), 1, 15) == FALSE
