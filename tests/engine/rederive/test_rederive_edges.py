"""The second path's facts about people and between them, on worlds small enough to work out by hand."""

import pytest
from readings import EASY, HARD, MIDDLE, World, ask, at_t0, toward

from jrdb_avr.engine.rederive import FALSE, TRUE, UNKNOWN
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, SAME_GROUP

SECONDS = range(15, 301, 15)
EVERY = range(0, 301)
FEMALE = Condition(attribute="gender", value="female")
MALE = Condition(attribute="gender", value="male")


# -- what a person is and has ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("said", "female", "male"),
    [
        (["female", "female", "male"], UNKNOWN, UNKNOWN),  # one vote that differs is enough
        (["female", "male"], UNKNOWN, UNKNOWN),
        (["female", ("male", HARD), ("male", None)], TRUE, FALSE),
        (["female", None, None], TRUE, FALSE),  # "impossible" has no vote
        ([("female", HARD)], UNKNOWN, UNKNOWN),
        ([("female", MIDDLE)], TRUE, FALSE),
        (["female", "female", "alien"], UNKNOWN, UNKNOWN),
        (["alien"], UNKNOWN, UNKNOWN),
        ([], UNKNOWN, UNKNOWN),
    ],
)
def test_gender_is_what_all_frames_say(said, female, male):
    world = World(SECONDS).see(1, SECONDS)
    for frame, value in zip(SECONDS, said, strict=False):
        world.tell(1, [frame], gender=value)
    annotations = world.read()
    assert annotations.holds(FEMALE, 1, 300) == female
    assert annotations.holds(MALE, 1, 300) == male


def test_gender_needs_a_visible_face_where_there_are_poses():
    def world(**faces):
        made = World(SECONDS).see(1, SECONDS).see(2, SECONDS, x=100)
        made.tell(1, SECONDS, gender="female").tell(2, SECONDS, gender="male")
        return made.show_face(2, SECONDS) if faces.get("poses") else made

    def faults(made):
        return ask(made, "presence", [FEMALE], [15, 60, 105]).faults

    hidden = ("gender or age describes somebody whose face is not visible",)
    assert faults(world()) == ()
    assert faults(world(poses=True)) == hidden
    assert faults(world(poses=True).show_face(1, [15], seen=False)) == hidden
    assert faults(world(poses=True).show_face(1, [15])) == ()


SHELF, ACCESSORY = (at_t0(object=name, verb="holding") for name in ("shelf", "accessory"))


@pytest.mark.parametrize(
    ("things", "listed", "shelf", "accessory"),
    [
        ([], True, FALSE, FALSE),
        ([], False, UNKNOWN, UNKNOWN),
        ([("holding", 57)], False, TRUE, UNKNOWN),
        ([("holding", 57)], True, TRUE, FALSE),
        ([(("holding", HARD), 57)], True, UNKNOWN, FALSE),
        ([(("holding", HARD), 57), ("holding", 57)], True, TRUE, FALSE),
        ([("holding", 900)], True, UNKNOWN, UNKNOWN),  # a thing of a name that nobody knows
        ([("holding", 12)], True, UNKNOWN, UNKNOWN),  # of a number that no file names
        ([("carrying", 57)], True, UNKNOWN, FALSE),  # who carries a thing also holds it
        ([("touching", 57)], True, FALSE, FALSE),
        ([("holding", 63)], True, FALSE, FALSE),  # people are no things
    ],
)
def test_things_handled(things, listed, shelf, accessory):
    world = World(SECONDS).see(1, SECONDS)
    if listed:
        world.list([1], SECONDS, "handles")
    for verb, category in things:
        world.handle(1, [15], verb, category)
    annotations = world.read()
    assert annotations.holds(SHELF, 1, 15) == shelf
    assert annotations.holds(ACCESSORY, 1, 15) == accessory


def test_gaps_of_handling_are_closed_where_every_frame_is_labelled():
    def state(missing):
        world = World(EVERY).see(1, EVERY).list([1], EVERY, "handles")
        return world.handle(1, [f for f in EVERY if f not in missing], "holding", 57).read().holds(SHELF, 1, 60)

    assert state(range(60, 67)) == UNKNOWN
    assert state(range(60, 68)) == FALSE


# -- interactions ---------------------------------------------------------------------------------------------------

TALKS = at_t0(interaction="conversation")


def pair(**difficulties):
    """Two people whose lists were read; `one` and `two` are the codes of what each says of the other."""
    world = World(SECONDS).see(1, SECONDS).see(2, SECONDS, x=100).list([1, 2], SECONDS)
    for name, (track, partner) in {"one": (1, 2), "two": (2, 1)}.items():
        if name in difficulties:
            world.join(track, partner, [15], ("conversation", difficulties[name]))
    return world


@pytest.mark.parametrize(
    ("said", "state"),
    [
        ({"one": EASY}, TRUE),
        ({"two": MIDDLE}, TRUE),
        ({"one": HARD}, UNKNOWN),
        ({"one": HARD, "two": None}, UNKNOWN),
        ({"one": HARD, "two": EASY}, TRUE),
        ({}, FALSE),
    ],
)
def test_an_interaction_said_once_holds_shift_frames(said, state):
    annotations = pair(**said).read()
    for track, other in ((1, 2), (2, 1)):
        assert annotations.related("conversation", track, other, 15) == state
        assert annotations.holds(TALKS, track, 15) == state
        assert annotations.related("hugging", track, other, 15) == FALSE


def test_an_interaction_with_somebody_without_a_box_leaves_the_others_open():
    annotations = pair().join(1, 3, [15]).read()
    assert annotations.holds(TALKS, 1, 15) == UNKNOWN
    assert annotations.step_to("conversation", 1, 15) == ("unknown", None)
    assert annotations.step_to("conversation", 1, 30) == ("empty", None)


def test_somebody_whose_list_was_not_read_could_be_in_any_interaction():
    annotations = pair().see(3, [15], x=2000).read()
    assert annotations.holds(TALKS, 1, 15) == UNKNOWN
    assert annotations.step_to("conversation", 1, 15) == ("unknown", None)
    assert annotations.step_to("conversation", 1, 30) == ("empty", None)
    certain = pair(one=EASY).see(3, [15], x=2000).read()
    assert certain.holds(TALKS, 1, 15) == TRUE
    assert certain.step_to("conversation", 1, 15) == ("unknown", None)


def test_a_step_leads_to_exactly_one_person():
    world = pair(one=EASY).see(3, [15], x=2000).list([3], [15])
    assert world.read().step_to("conversation", 1, 15) == ("defined", 2)
    assert world.read().step_to("conversation", 2, 15) == ("defined", 1)
    hard = pair(one=EASY).see(3, [15], x=2000).list([3], [15]).join(3, 1, [15], ("conversation", HARD))
    assert hard.read().step_to("conversation", 1, 15) == ("unknown", None)
    assert hard.read().step_to("conversation", 2, 15) == ("defined", 1)
    several = pair(one=EASY).see(3, [15], x=2000).list([3], [15]).join(3, 1, [15])
    assert several.read().step_to("conversation", 1, 15) == ("ambiguous", None)


def test_gaps_of_interactions_are_closed_where_every_frame_is_labelled():
    def state(missing, frame):
        world = World(EVERY).see(1, EVERY).see(2, EVERY, x=100).list([1, 2], EVERY)
        return world.join(1, 2, [f for f in EVERY if f not in missing]).read().related("conversation", 2, 1, frame)

    assert [state(range(60, 67), frame) for frame in (59, 60, 66, 67)] == [TRUE, UNKNOWN, UNKNOWN, TRUE]
    assert state(range(60, 68), 60) == FALSE
    seconds = World(SECONDS).see(1, SECONDS).see(2, SECONDS, x=100).list([1, 2], SECONDS)
    assert seconds.join(1, 2, [15, 45]).read().related("conversation", 1, 2, 30) == FALSE


def test_same_group():
    def related(first, second):
        world = World(SECONDS).see(1, [15], group=first).see(2, [15], x=100, group=second)
        return world.read().related(SAME_GROUP, 1, 2, 15)

    assert related(7, 7) == TRUE
    assert related(7, 8) == FALSE
    assert related(7, (7, HARD)) == UNKNOWN
    assert related(7, (8, HARD)) == FALSE
    assert related(7, None) == UNKNOWN
    three = World(SECONDS).see(1, [15], group=7).see(2, [15], x=100, group=7).see(3, [15], x=200, group=8)
    assert [three.read().step_to(SAME_GROUP, track, 15) for track in (1, 2, 3)] == [
        ("defined", 2),
        ("defined", 1),
        ("empty", None),
    ]


# -- as the robot sees it -------------------------------------------------------------------------------------------


def row(*degrees, hidden=()):
    """People 0, 1, ... in these directions; those in `hidden` are no clear views."""
    world = World(SECONDS)
    for track, angle in enumerate(degrees):
        world.see(track, [15], x=toward(angle), occlusion="Fully_occluded" if track in hidden else "Fully_visible")
    return world.read()


@pytest.mark.parametrize(
    ("degrees", "hidden", "left", "right"),
    [
        # Left is towards smaller panorama angles.
        ((100, 90, 120), (), ("defined", 1), ("defined", 2)),
        ((100, 90, 88.5), (), ("defined", 1), ("empty", None)),
        ((100, 90, 89.5), (), ("unknown", None), ("empty", None)),  # the next is under a degree farther
        ((100, 99.5, 80), (), ("unknown", None), ("empty", None)),  # the nearest is under a degree away
        ((100, 90, 80), (1,), ("unknown", None), ("empty", None)),  # the nearest is no clear view
        ((100, 90, 80), (2,), ("defined", 1), ("empty", None)),
        ((100, 41, 159), (), ("defined", 1), ("defined", 2)),
        ((100, 39, 161), (), ("empty", None), ("empty", None)),  # more than 60 degrees away
        ((100, 90), (1,), ("unknown", None), ("empty", None)),
        ((2, 358, 12), (), ("defined", 1), ("defined", 2)),  # across the seam
        ((358, 2, 340), (), ("defined", 2), ("defined", 1)),
    ],
)
def test_the_first_person_to_one_side(degrees, hidden, left, right):
    annotations = row(*degrees, hidden=hidden)
    assert annotations.step_to(FIRST_LEFT, 0, 15) == left
    assert annotations.step_to(FIRST_RIGHT, 0, 15) == right


@pytest.mark.parametrize(
    ("away", "left_30", "left_90", "right_30"),
    [
        (-10, TRUE, TRUE, FALSE),
        (-28.9, TRUE, TRUE, FALSE),
        (-29.1, UNKNOWN, TRUE, FALSE),
        (-30.9, UNKNOWN, TRUE, FALSE),
        (-31.1, FALSE, TRUE, FALSE),
        (-91.1, FALSE, FALSE, FALSE),
        (-0.9, UNKNOWN, UNKNOWN, UNKNOWN),
        (0.9, UNKNOWN, UNKNOWN, UNKNOWN),
        (10, FALSE, FALSE, TRUE),
        (180, FALSE, FALSE, FALSE),
    ],
)
@pytest.mark.parametrize("own", [200, 5, 355])
def test_windows_have_margins(own, away, left_30, left_90, right_30):
    annotations = row(own, (own + away) % 360, hidden=(1,))
    assert annotations.related("within 30 degrees to the left of (robot view)", 0, 1, 15) == left_30
    assert annotations.related("within 90 degrees to the left of (robot view)", 0, 1, 15) == left_90
    assert annotations.related("within 30 degrees to the right of (robot view)", 0, 1, 15) == right_30


# -- in space -------------------------------------------------------------------------------------------------------


AHEAD = ("front", "front left", "left", "front right", "right")
BEHIND = ("back", "back left", "left", "back right", "right")
LEFT, RIGHT = (("front", f"front {side}", side, f"back {side}", "back") for side in ("left", "right"))
FRONT_LEFT, FRONT_RIGHT, BACK_LEFT = AHEAD[:3], ("front", "front right", "right"), BEHIND[:3]


@pytest.mark.parametrize(
    ("there", "heading", "true", "possible", "words"),
    [
        ((2, 0), 0, "front", AHEAD, "moderate"),
        ((2, 0), 90, "right", RIGHT, "moderate"),  # facing the robot's left, what is ahead of the robot is to the right
        ((2, 0), -90, "left", LEFT, "moderate"),
        ((-2, 0), 0, "back", BEHIND, "moderate"),
        ((0, 1), 0, "left", LEFT, "close"),
        ((0, -1), 0, "right", RIGHT, "close"),
        ((0.9, 0.9), 26, "front", FRONT_LEFT, "close"),  # 19 degrees to the left
        ((0.9, 0.9), 24, None, FRONT_LEFT, "close"),  # 21 degrees
        ((0.9, 0.9), 7, "front left", FRONT_LEFT, "close"),  # 38 degrees
        ((0.9, 0.9), 14, None, FRONT_LEFT, "close"),  # 31 degrees
        ((0.9, 0.9), 1, None, FRONT_LEFT, "close"),  # 44 degrees
        ((0.9, 0.9), -24, None, FRONT_LEFT, "close"),  # 69 degrees
        ((0.9, 0.9), -26, "left", FRONT_LEFT, "close"),  # 71 degrees
        ((0.9, -0.9), -7, "front right", FRONT_RIGHT, "close"),
        ((-0.9, 0.9), -5, "back left", BACK_LEFT, "close"),  # 140 degrees
        ((-0.9, 0.9), 0, None, BACK_LEFT, "close"),  # 135 degrees
        ((1.4, 0), 0, None, AHEAD, "close or moderate"),
        ((4.4, 0), 0, "front", AHEAD, "moderate"),
        ((4.6, 0), 0, None, AHEAD, "moderate"),
        ((5.4, 0), 0, None, AHEAD, "moderate"),
        ((5.6, 0), 0, None, (), "moderate"),
        ((2, 0, 1.4), 0, None, AHEAD, "moderate"),  # on another floor
        ((2, 0, 1.3), 0, "front", AHEAD, "moderate"),
        ((0.2, 0, 1.3), 0, "front", AHEAD, "close"),  # the distance is that in space
        ((0, 0.4), 0, "left", LEFT, "very close"),
    ],
)
@pytest.mark.parametrize("origin", [(0, 0), (-7.0, 3.0)])
def test_places_from_a_person(origin, there, heading, true, possible, words):
    place = (origin[0] + there[0], origin[1] + there[1], *there[2:])
    world = World(SECONDS).see(1, [15], at=origin, heading=heading).see(2, [15], x=100, at=place)
    annotations = world.read()
    sectors = ("front", "front left", "left", "back left", "back", "back right", "right", "front right")
    labels = [f"{sector}, {word}" for sector in sectors for word in ("very close", "close", "moderate")]
    found = {label: annotations.related(label, 1, 2, 15) for label in labels}
    expected = {f"{sector}, {word}": UNKNOWN for sector in possible for word in words.split(" or ")}
    expected |= {f"{true}, {words}": TRUE} if true else {}
    assert {label: state for label, state in found.items() if state != FALSE} == expected


def test_without_lidar_points_any_place_is_possible():
    world = (
        World(SECONDS).see(1, [15], at=(0, 0)).see(2, [15], x=100, at=(2, 0)).see(3, [15], x=200, at=(2, 2), points=0)
    )
    assert world.read().related("front, moderate", 1, 3, 15) == UNKNOWN
    assert world.read().step_to("front, moderate", 1, 15) == ("unknown", None)
    assert world.read().step_to("front, moderate", 3, 15) == ("unknown", None)
    found = World(SECONDS).see(1, [15], at=(0, 0)).see(2, [15], x=100, at=(2, 0)).read()
    assert found.step_to("front, moderate", 1, 15) == ("defined", 2)
    assert found.step_to("back, moderate", 1, 15) == ("empty", None)
