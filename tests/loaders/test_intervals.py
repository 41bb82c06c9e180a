"""Interval tables of small sequences, worked out by hand: segments, keyframes, poses, groups and sectors."""

import pytest
from readings import HARD, World, intervals_of, toward

from jrdb_avr.schema.rules import LoadRules, Rules

ANY = LoadRules(visibility="any")
EVERY = range(301)
SECONDS = range(0, 301, 15)


def derived(world, kind, rules=LoadRules()):  # noqa: B008 - frozen
    return intervals_of(world, rules)[kind].to_pylist()


def reader(frames, on, hard=(), missing=(), occluded=()):
    """Somebody who stands and reads at the frames `on`, beside another person who walks."""
    world = World(frames).see(9, frames, ["walking"], x=100)
    for frame in frames:
        extra = ["reading"] if frame in on else [("reading", HARD)] if frame in hard else []
        if frame not in missing:
            occlusion = "Fully_occluded" if frame in occluded else "Fully_visible"
            world.see(1, [frame], ["standing", *extra], occlusion=occlusion)
    return world


def segments(frames, on, **more):
    names = ("first", "last", "start", "end", "closed")
    rows = derived(reader(frames, on, **more), "segments")
    return [tuple(row[name] for name in names) for row in rows if row["action"] == "reading"]


def test_a_segment_at_fifteen_frames_per_second_is_what_is_labelled():
    assert segments(EVERY, range(100, 200)) == [(100, 199, 100, 199, True)]


def test_a_segment_at_one_frame_per_second_is_half_a_step_wider():
    assert segments(SECONDS, range(90, 181)) == [(90, 180, 83, 187, True)]


@pytest.mark.parametrize(
    "broken",
    [
        {"on": range(100, 130)},  # 29 frames from first to last
        {"on": range(14, 100)},  # less than a second before it
        {"on": range(100, 200), "hard": [60]},
        {"on": range(100, 200), "hard": [244]},
        {"on": range(100, 200), "missing": [90]},
        {"on": range(100, 200), "occluded": [90]},
        {"on": range(100, 200), "occluded": [150]},
    ],
)
def test_what_has_no_clear_start_is_no_segment(broken):
    assert segments(EVERY, **broken) == []


@pytest.mark.parametrize(
    ("fine", "first", "last", "closed"),
    [
        ({"on": range(100, 131)}, 100, 130, True),
        ({"on": range(15, 100)}, 15, 99, True),
        ({"on": range(100, 200), "hard": [54, 245]}, 100, 199, True),
        ({"on": range(100, 200), "occluded": [84]}, 100, 199, True),
        ({"on": range(100, 286)}, 100, 285, True),
        ({"on": range(100, 287)}, 100, 286, False),
        ({"on": range(100, 200), "occluded": [205]}, 100, 199, False),
        ({"on": [*range(100, 140), *range(147, 200)]}, 100, 199, True),  # seven frames are a closed gap
        ({"on": range(100, 200), "missing": [150]}, 100, 199, True),
    ],
)
def test_what_has_a_clear_start_is_a_segment(fine, first, last, closed):
    assert segments(EVERY, **fine) == [(first, last, first, last, closed)]


@pytest.mark.parametrize(("before", "after"), [("walking", "sitting"), ("lying", "standing")])
def test_a_posture_starts_when_the_other_one_ends(before, after):
    world = World(EVERY).see(1, range(100), [before]).see(1, range(100, 301), [after])
    assert [row["first"] for row in derived(world, "segments") if row["action"] == after] == [100]


def test_a_longer_gap_parts_what_is_then_no_segment():
    assert segments(EVERY, [*range(100, 140), *range(148, 200)]) == []


def test_keyframes_are_whole_seconds_within_the_labelled_frames():
    (row,) = derived(reader(range(7, 50), []), "sequence")
    assert row["keyframes"] == [15, 30, 45]


def test_of_two_poses_neither_is_certain():
    world = World(SECONDS).see(1, [0], ["standing"]).see(1, [15], ["standing", "sitting"]).see(1, [30], ["sitting"])
    rows = derived(world, "actions")
    assert [(row["action"], row["first"], row["certain"]) for row in rows] == [
        ("sitting", 15, False),
        ("sitting", 30, True),
        ("standing", 0, True),
        ("standing", 15, False),
    ]


def test_a_hard_label_stays_a_label_beside_a_fact_without_one():
    # A person who runs may be said to walk.
    world = World(SECONDS).see(1, [0], [("walking", HARD)]).see(1, [15], ["running"])
    labels, possible = (derived(world, kind) for kind in ("actions", "possible_actions"))
    assert [(row["action"], row["first"], row["last"], row["certain"]) for row in labels] == [
        ("running", 15, 15, True),
        ("walking", 0, 0, False),
    ]
    assert [(row["action"], row["first"], row["last"], row["gap"]) for row in possible] == [
        ("running", 0, 0, False),
        ("walking", 15, 15, False),
    ]


@pytest.mark.parametrize("rules", [LoadRules(), ANY])
def test_a_group_has_a_size_where_everybody_certainly_is_in_or_out(rules):
    world = World([0, 15, 30, 45])
    for frame, third in ((0, 8), (15, 7), (30, (7, HARD)), (45, None)):
        world.see(1, [frame], group=7).see(2, [frame], group=7).see(3, [frame], group=third)
    sizes = [row["group_size"] for row in derived(world, "sightings", rules)]
    # A hard label leaves its own group open, a person without a group every group.
    assert sizes == [2, 2, 1] + [3, 3, 3] + [None] * 3 + [None] * 3


def test_a_member_without_a_box_for_a_second_leaves_the_size_of_the_group_open():
    """Actions once a second, groups in every frame; the third member has a box from frame 8 to 14 only."""
    world = World(range(31))
    world.action_frames = {0, 15, 30}
    for frame in range(31):
        for track in (1, 2, 3) if 8 <= frame <= 14 else (1, 2):
            world.see(track, [frame], None if frame % 15 else ["standing"], group=7)
    sizes = {row["frame"]: row["group_size"] for row in derived(world, "sightings", ANY)}
    assert [sizes[frame] for frame in (0, 7, 8, 14, 15, 29, 30)] == [None, None, 3, 3, None, None, 2]


@pytest.mark.parametrize("lost", ["the record", "the group"])
def test_a_member_who_could_be_hidden_leaves_the_size_of_the_group_open(lost):
    """The third member is seen at frame 20 alone, where the record or its group cannot be read."""
    world = World(range(41))
    for frame in range(41):
        for track in (1, 2):
            world.see(track, [frame], ["standing"], group=7)
    if lost == "the record":
        world.frames.remove(20)
    else:
        world.see(3, [20], ["standing"])
    sizes = {row["frame"]: row["group_size"] for row in derived(world, "sightings", ANY)}
    assert [frame for frame, size in sizes.items() if size is None] == list(range(5, 36))


@pytest.mark.parametrize("shown_by", ["a box", "a group", "an image"])
@pytest.mark.parametrize(("unread", "doubtful"), [(0, range(1, 16)), (40, range(25, 40))])
def test_an_unreadable_frame_at_an_end_leaves_the_size_of_the_group_open(unread, doubtful, shown_by):
    """Labelling goes on beyond the readable frames, and somebody of the group could be seen there.

    An image alone does not tell so: panoramas go on where nobody labels any more.
    """
    readable = [frame for frame in range(41) if frame != unread]
    world = World(readable)
    for track in (1, 2):
        world.see(track, readable, ["standing"], group=7)
    if shown_by == "a box":
        world.see(1, [unread], None)
    elif shown_by == "a group":
        world.group_frames = [*readable, unread]
    else:
        world.images = [unread]
    sizes = {row["frame"]: row["group_size"] for row in derived(world, "sightings", ANY) if row["frame"] != unread}
    read = world.read(Rules(load=ANY))
    found = {frame: [*read.group_sizes(1, frame)] for frame in sizes}
    assert found == {frame: [] if size is None else [size] for frame, size in sizes.items()}
    expected = [] if shown_by == "an image" else list(doubtful)
    assert [frame for frame, size in sizes.items() if size is None] == expected


@pytest.mark.parametrize(
    ("degrees", "sector"),
    [(180, "ahead"), (141, "ahead"), (139, None), (131, None), (129, "left"), (2, "behind"), (358, "behind")],
)
def test_between_two_sectors_there_is_none(degrees, sector):
    (row,) = derived(World([0]).see(1, [0], x=toward(degrees)), "sightings")
    assert row["sector"] == sector
