"""Readings are votes: they add up in any order, settle by agreement, and count for no more than a cap."""

import itertools

import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from readings import toward

from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.agent.perceive.votes import MOST_VOTES, UNIT, Tracks, settled
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import WIDTH, Box, iou
from jrdb_avr.schema.relations import FIRST_LEFT, SAME_GROUP

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


def test_two_readings_that_agree_settle_and_a_third_decides_between_two():
    def woman(*readings):
        return tracks(p=[read(one) for one in readings]).statement("p", *WOMAN, None)

    assert woman(WOMAN).state == "supported" and not woman(WOMAN).settled
    assert woman(WOMAN, WOMAN).state == "certain"
    assert woman(WOMAN, WOMAN, WOMAN).log_odds == MOST_VOTES * UNIT
    assert woman(WOMAN, MAN).state == "open" and not woman(WOMAN, MAN).settled
    assert not woman(WOMAN, MAN, MAN, WOMAN).settled
    assert woman(WOMAN, MAN, WOMAN).state == "certain"
    assert woman(WOMAN, MAN, MAN).state == "contradicted" and woman(WOMAN, MAN, MAN).settled


@given(st.lists(st.tuples(st.sampled_from((*[("action", w) for w in ("walking", "running", "sitting")], WOMAN, MAN)),
                          st.booleans(), st.sampled_from((0.5, 0.7, 0.9, 1.0)), st.sampled_from((0, 15, 20, 45))),
                max_size=6), st.randoms(use_true_random=False))  # fmt: skip
def test_votes_come_in_any_order_and_count_for_no_more_than_the_cap(votes, rng):
    readings = [read(ReadLabel(*label, holds, sure), frame=frame) for label, holds, sure, frame in votes]
    shuffled = rng.sample(readings, len(readings))
    for name, value in (("action", "walking"), WOMAN):
        one, other = (tracks(p=order).statement("p", name, value, 15) for order in (readings, shuffled))
        assert one.log_odds == pytest.approx(other.log_odds) and one[1:] == other[1:]
        assert abs(one.log_odds) <= MOST_VOTES * UNIT
        more = tracks(p=[*readings, read((name, value))]).statement("p", name, value, 15)
        at_frame = [reading for reading in readings if reading.frame == 15 or name == "gender"]
        before = tracks(p=at_frame).statement("p", name, value, 15)
        assert more.log_odds >= before.log_odds and more.votes == before.votes + 1


def test_words_that_may_be_said_of_another_label_are_no_vote():
    runs = tracks(p=[read(("action", "running"))])
    assert runs.statement("p", "action", "walking", 15).state == "open"
    assert runs.statement("p", "action", "sitting", 15).state == "contradicted"
    # Nobody reads because they write, nor does the one exclude the other.
    assert tracks(p=[read(("action", "writing"))]).statement("p", "action", "reading", 15).state == "open"


def test_gender_holds_at_every_frame_and_a_pose_fades():
    seen = tracks(p=[read(WOMAN, ("action", "walking"), frame=0), read(WOMAN, ("action", "walking"), frame=0)])
    assert seen.statement("p", *WOMAN, 900).state == "certain"
    within, beyond = (seen.statement("p", "action", "walking", frame) for frame in (15, 60))
    assert within.state == "certain" and beyond.state == "supported"
    assert seen.statement("p", "action", "walking", 0).log_odds == 2 * within.log_odds == 16 * beyond.log_odds


def test_values_of_a_topic_are_ranked_and_what_is_outside_the_choices_can_be_passed_over():
    poses = [read(("action", one)) for one in ("running", "walking", "running")]
    first, second = tracks(p=poses).values("p", "pose", 15)
    assert (first.value, first.votes, second.value, second.votes) == ("running", 2, "walking", 1)
    assert settled((first, second)) and not settled((second,)) and not settled(())
    assert not settled(tracks(p=poses[:2]).values("p", "pose", 15))


def test_the_median_of_distances_counts_and_each_votes_on_a_word():
    far = tracks(p=[read(metres=metres) for metres in (7.0, 30.0, 6.5)])
    assert far.metres("p", 15) == 7.0 and far.metres("p", 16) is None
    assert far.statement("p", "distance", "far", 15) == (pytest.approx(UNIT), 2, 1)
    assert far.statement("p", "sector", "left", 15).votes == 3


BOXES = st.builds(Box, st.sampled_from((0.0, 10.0, 30.0, WIDTH - 5.0, -5.0, 500.0)), st.just(100.0),
                  st.sampled_from((50.0, 60.0)), st.sampled_from((120.0, 150.0)))  # fmt: skip


@given(st.lists(st.tuples(BOXES, st.booleans()), min_size=1, max_size=6))
@settings(max_examples=examples(60))
def test_the_box_is_one_of_the_largest_cluster(boxes):
    fused = tracks(p=[read(box=box, whole=whole) for box, whole in boxes]).box("p", 15)
    sizes = {box: sum(iou(box, other) >= 0.5 for other, _ in boxes) for box, _ in boxes}
    assert fused.votes == max(sizes.values()) == sizes[fused.box]
    whole = [box for box, is_whole in boxes if is_whole and sizes[box] == fused.votes]
    assert not whole or fused.box in whole


def test_relations_are_read_of_either_person_or_follow_from_boxes():
    talk = ReadTie("conversation", 2)
    people = {"a": [read(angle=100, observation="o", ties=(talk,))], "b": [read(angle=80, observation="o", number=2)]}
    seen = tracks({15: (SeenColumns(0, WIDTH),)}, **people)
    assert seen.relation("b", "conversation", "a", 15).state == "supported"
    assert seen.relation("a", "hugging", "b", 15).state == "open"
    assert seen.relation("a", FIRST_LEFT, "b", 15).state == "supported"
    assert seen.relation("b", FIRST_LEFT, "a", 15).state == "contradicted"
    assert tracks({15: ()}, **people).relation("a", FIRST_LEFT, "b", 15).state == "open"
    # Nothing was looked at a second later: what was seen before stands for it.
    assert seen.relation("a", FIRST_LEFT, "b", 30).log_odds == UNIT / 2
    for who, votes in (("a", 1), ("b", 1), ("c", 0)):
        assert seen.statement(who, "interaction", "conversation", 15).votes == votes


def in_two_pictures(relation, holds=True):
    """Support for a relation from a to c: one picture has it between a and b, another between c and b."""
    a = read(angle=100, observation="o1", number=1, ties=(ReadTie(relation, 2),))
    b = [read(angle=130, observation=one, number=2) for one in ("o1", "o2")]
    c = read(angle=160, observation="o2", number=1, ties=(ReadTie(relation, 2, holds=holds),))
    return tracks({15: ()}, a=[a], b=b, c=[c]).relation("a", relation, "c", 15)


def test_people_of_different_pictures_are_of_one_group_where_others_join_them():
    assert in_two_pictures(SAME_GROUP) == (UNIT, 1, 0)
    assert in_two_pictures(SAME_GROUP, holds=False) == (0, 0, 0)
    assert in_two_pictures("conversation") == (0, 0, 0)


def test_whoever_most_looks_at_the_place_do_not_show_stands_between_nobody():
    crop = SeenColumns(toward(100.0) - 200, 480)
    between = tracks({15: (crop,)}, p=[read()], g=[read(angle=105.0)], q=[read(angle=110.0)])
    assert between.relation("q", FIRST_LEFT, "g", 15).log_odds > 0
    again = tracks({15: (crop,) * 3}, p=[read()] * 3, g=[read(angle=105.0)], q=[read(angle=110.0)] * 3)
    assert (again.looks_at("g", 15), again.missed("g", 15), again.missed("p", 15)) == (3, 1, -3)
    assert set(again.boxes(15)) == {"p", "q"}
    assert again.relation("q", FIRST_LEFT, "p", 15).log_odds > 0
    assert again.relation("q", FIRST_LEFT, "g", 15).state == "open"


def test_a_reading_keeps_to_the_vocabularies():
    for label in (
        ("gender", "woman"),
        ("action", "flying"),
        ("group_size", "few"),
        ("sector", "front"),
        ("mood", ""),
        ("object", "bag"),
    ):
        with pytest.raises(DecodeError, match=label[0]):
            read(label)
    with pytest.raises(DecodeError, match="no relation"):
        read(ties=(ReadTie("knows", 2),))
    with pytest.raises(DecodeError, match="width"):
        read(box=Box(1, 1, 0, 5))
    assert read(("object", "holding: bag"), ("group_size", "3"), angle=359).angle == pytest.approx(359)
