"""Readings are votes: a frame has one, further frames count less, and no sum passes the cap."""

import itertools

import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from readings import toward

from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.agent.perceive.votes import CAP, CERTAIN, UNIT, Support, Tracks, signed, tie_key
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import WIDTH, Box
from jrdb_avr.schema.relations import FIRST_LEFT, SAME_GROUP
from jrdb_avr.schema.repeats import Repeats

NAMES = itertools.count()


def read(*labels, frame=15, angle=100.0, **more):
    box = Box(toward(angle), 100.0, 50.0, 150.0)
    labels = tuple(label if isinstance(label, ReadLabel) else ReadLabel(*label) for label in labels)
    return PersonReading(
        **{"observation": f"o{next(NAMES)}", "number": 1, "frame": frame, "box": box} | more, labels=labels
    )


def tracks(looks=None, **people):
    return Tracks({who: tuple(readings) for who, readings in people.items()}, looks or {})


WOMAN, MAN = ("gender", "female"), ("gender", "male")


def by_definition(votes, frame, repeats):
    """The log-odds of (frame, log-odds of one reading) in their order, summed as the definition says."""
    frames = {at for at, _ in votes}
    if not frames:
        return 0.0
    nearest = votes[0][0] if frame is None else sorted(frames, key=lambda at: (abs(at - frame), at))[0]
    total = 0.0
    for index, (at, vote) in enumerate(votes):
        total += (
            vote
            * (repeats.frame if any(before == at for before, _ in votes[:index]) else 1.0)
            * (1.0 if at == nearest else repeats.person)
            * (1.0 if frame is None else 2.0 ** -(abs(at - frame) / 15))
        )
    return min(max(total, -CAP), CAP)


SHARES = st.sampled_from((0.0, 0.05, 0.25, 1.0))


@given(
    st.lists(st.tuples(st.sampled_from((0, 15, 20, 45)), st.booleans()), max_size=7),
    st.builds(Repeats, SHARES, SHARES),
    st.sampled_from((0, 15, 16, 30, 300)),
)
@settings(max_examples=examples(200))
def test_the_support_of_readings_is_the_sum_of_the_definition(given_votes, repeats, frame):
    for (name, value), at in ((("action", "writing"), frame), (WOMAN, None)):
        readings = [read(ReadLabel(name, value, holds), frame=when) for when, holds in given_votes]
        seen = Tracks({"p": tuple(readings)}, {}, repeats)
        votes = [(when, signed(holds)) for when, holds in given_votes]
        support = seen.statement("p", name, value, frame)
        assert support.log_odds == pytest.approx(by_definition(votes, at, repeats))
        odds = seen.values("p", WOMAN[0], None)
        if name == "gender" and odds:
            assert next(iter(odds.values())) == pytest.approx(support.log_odds)


@given(st.lists(st.tuples(st.sampled_from((0, 15, 20)), st.booleans()), min_size=1, max_size=6), st.randoms())
@settings(max_examples=examples(60))
def test_the_order_of_frames_does_not_matter_and_one_more_reading_for_a_value_does_no_harm(votes, rng):
    readings = [read(ReadLabel("action", "walking", holds), frame=frame) for frame, holds in votes]
    order = sorted({frame for frame, _ in votes}, key=lambda _: rng.random())
    moved = [reading for frame in order for reading in readings if reading.frame == frame]
    before, after = (tracks(p=each).statement("p", "action", "walking", 15) for each in (readings, moved))
    assert before.log_odds == pytest.approx(after.log_odds) and abs(before.log_odds) <= CAP
    more = tracks(p=[*[one for one in readings if one.frame == 15], read(("action", "walking"))])
    fewer = tracks(p=[one for one in readings if one.frame == 15])
    assert (
        more.statement("p", "action", "walking", 15).log_odds >= fewer.statement("p", "action", "walking", 15).log_odds
    )


def test_a_frame_counts_one_reading_and_another_frame_a_quarter():
    def woman(*frames):
        return tracks(p=[read(WOMAN, frame=frame) for frame in frames]).statement("p", *WOMAN, None)

    assert woman(15) == (UNIT,) and woman(15).state == "certain"
    assert woman(15, 15) == (pytest.approx(1.05 * UNIT),)
    assert woman(15, 60) == (pytest.approx(1.25 * UNIT),)
    assert woman(15, 60, 90, 120) == (CAP,)
    # The first reading of a frame has the vote, whatever later readings of the frame say.
    doubted = tracks(p=[read(WOMAN), read(MAN), read(MAN)]).statement("p", *WOMAN, None)
    assert (
        doubted == (pytest.approx(0.9 * UNIT),) and Support().state == "open" and Support(-0.1).state == "contradicted"
    )
    assert Support(CERTAIN).state == "certain" and Support(CERTAIN - 0.01).state == "supported"


def test_a_reading_that_leaves_a_value_open_takes_the_vote_of_its_frame():
    runs = tracks(p=[read(("action", "running")), read(("action", "walking"))])
    assert runs.statement("p", "action", "walking", 15).log_odds == pytest.approx(0.05 * UNIT)


def test_words_that_may_be_said_of_another_label_are_no_vote():
    runs = tracks(p=[read(("action", "running"))])
    assert runs.statement("p", "action", "walking", 15).state == "open"
    assert runs.statement("p", "action", "sitting", 15).state == "contradicted"
    # Nobody reads because they write, nor does the one exclude the other.
    assert tracks(p=[read(("action", "writing"))]).statement("p", "action", "reading", 15).state == "open"


def test_gender_holds_at_every_frame_and_a_pose_fades():
    seen = tracks(p=[read(WOMAN, ("action", "walking"), frame=0)])
    assert seen.statement("p", *WOMAN, 900).state == "certain"
    at, later, much_later = (seen.statement("p", "action", "walking", frame) for frame in (0, 15, 60))
    assert (at.state, later.state) == ("certain", "supported")
    assert at.log_odds == pytest.approx(2 * later.log_odds) == pytest.approx(16 * much_later.log_odds)


def test_values_of_a_topic_are_ranked_by_the_nearest_frame():
    poses = [read(("action", pose), frame=frame) for pose, frame in (("running", 15), ("walking", 15), ("sitting", 60))]
    assert [*tracks(p=poses).values("p", "pose", 20)] == ["running", "walking"]
    assert [*tracks(p=poses).values("p", "pose", 50)] == ["sitting"]
    assert tuple(tracks(p=poses).values("p", "pose", 15).values()) == (UNIT, pytest.approx(0.05 * UNIT))
    assert {*tracks(p=poses).values("p", "pose", None)} == {"running", "walking", "sitting"}


def test_the_median_of_distances_counts_and_each_votes_on_a_word():
    far = tracks(p=[read(metres=metres) for metres in (7.0, 30.0, 6.5)])
    assert far.metres("p", 15) == 7.0 and far.metres("p", 16) is None
    assert far.statement("p", "distance", "far", 15) == (pytest.approx(UNIT),)
    assert far.statement("p", "distance", "very far", 15).log_odds < 0
    assert far.statement("p", "sector", "left", 15) == (pytest.approx(1.1 * UNIT),)


def test_the_box_is_the_first_that_shows_the_person_whole():
    cut, whole, last = (Box(left, 100.0, 50.0, 150.0) for left in (0.0, 10.0, 30.0))
    seen = tracks(p=[read(box=cut, whole=False), read(box=whole), read(box=last)])
    assert seen.box("p", 15) == whole and seen.box("p", 16) is None
    assert tracks(p=[read(box=cut, whole=False), read(box=last, whole=False)]).box("p", 15) == cut


def test_relations_are_read_of_either_person_or_follow_from_boxes():
    talk = ReadTie("conversation", 2)
    people = {"a": [read(angle=100, observation="o", ties=(talk,))], "b": [read(angle=80, observation="o", number=2)]}
    seen = tracks({15: (SeenColumns(0, WIDTH),)}, **people)
    assert seen.relation("b", "conversation", "a", 15).state == "certain"
    assert seen.relation("a", "hugging", "b", 15).state == "open"
    assert seen.relation("a", FIRST_LEFT, "b", 15).state == "certain"
    assert seen.relation("b", FIRST_LEFT, "a", 15).state == "contradicted"
    assert tracks({15: ()}, **people).relation("a", FIRST_LEFT, "b", 15).state == "open"
    # Nothing was looked at a second later: what was seen before stands for it.
    assert seen.relation("a", FIRST_LEFT, "b", 30).log_odds == UNIT / 2
    for who, log_odds in (("a", UNIT), ("b", UNIT), ("c", 0)):
        assert seen.statement(who, "interaction", "conversation", 15).log_odds == log_odds


def test_the_first_picture_of_a_frame_has_the_vote_on_a_relation_whoever_it_was_read_of():
    def talk(first, second):
        a = [read(observation="o9", ties=()), read(observation="o10", ties=(ReadTie("conversation", 2, second),))]
        b = [
            read(observation="o9", number=2, ties=(ReadTie("conversation", 1, first),)),
            read(observation="o10", number=2),
        ]
        seen = tracks(a=a, b=b)
        votes = seen.tie_votes(tie_key("b", "conversation", "a"), 15)
        assert len(votes) == 2 and not seen.tie_votes(("b", "conversation", "a"), 15)
        return seen.relation("a", "conversation", "b", 15).log_odds

    assert talk(True, False) == -talk(False, True) == pytest.approx(0.95 * UNIT)


def in_two_pictures(relation, holds=True):
    """Support for a relation from a to c: one picture has it between a and b, another between c and b."""
    a = read(angle=100, observation="o1", number=1, ties=(ReadTie(relation, 2),))
    b = [read(angle=130, observation=one, number=2) for one in ("o1", "o2")]
    c = read(angle=160, observation="o2", number=1, ties=(ReadTie(relation, 2, holds=holds),))
    return tracks({15: ()}, a=[a], b=b, c=[c]).relation("a", relation, "c", 15)


def test_people_of_different_pictures_are_of_one_group_where_others_join_them():
    assert in_two_pictures(SAME_GROUP) == (UNIT,)
    assert in_two_pictures(SAME_GROUP, holds=False) == (0,)
    assert in_two_pictures("conversation") == (0,)


def test_whoever_most_looks_at_the_place_do_not_show_stands_between_nobody():
    crop = SeenColumns(toward(100.0) - 200, 480)
    between = tracks({15: (crop,)}, p=[read()], g=[read(angle=105.0)], q=[read(angle=110.0)])
    assert between.relation("q", FIRST_LEFT, "g", 15).log_odds > 0
    again = tracks({15: (crop,) * 3}, p=[read()] * 3, g=[read(angle=105.0)], q=[read(angle=110.0)] * 3)
    assert (again.looks_at("g", 15), again.missed("g", 15), again.missed("p", 15)) == (3, 1, -3)
    assert set(again.boxes(15)) == {"p", "q"}
    assert again.relation("q", FIRST_LEFT, "p", 15).log_odds > 0
    assert again.relation("q", FIRST_LEFT, "g", 15).state == "open"


def test_a_reading_has_a_box_and_an_angle():
    with pytest.raises(DecodeError, match="width"):
        read(box=Box(1, 1, 0, 5))
    assert read(angle=359).angle == pytest.approx(359)
