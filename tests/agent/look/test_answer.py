"""The answer that is read from fused readings, and the course of what somebody does, against every course there is."""

import itertools
from dataclasses import replace

import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from readings import WOMAN, reading_at, toward

from jrdb_avr.agent.look.answer import conclude
from jrdb_avr.agent.look.attention import next_looks
from jrdb_avr.agent.perceive.geometry import SeenColumns, seen_from
from jrdb_avr.agent.look.moments import CHANGE, Bracket, brackets, likeliest_course, postures
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel
from jrdb_avr.agent.look.ranking import rank
from jrdb_avr.agent.perceive.votes import UNIT, Tracks
from jrdb_avr.schema.answers import Choice, Number
from jrdb_avr.schema.panorama import WIDTH, Box
from jrdb_avr.schema.plan import AnswerSpec, Plan, Time

FRAMES = range(0, 900)


def read(frame, *poses, observation="o", metres=None):
    labels = (ReadLabel("gender", "female"), *(ReadLabel("action", pose) for pose in poses))
    return PersonReading(observation, 1, frame, Box(toward(100.0), 100.0, 50.0, 150.0), labels, metres=metres)


def woman(*readings):
    named = [
        PersonReading(f"o{n}", 1, one.frame, one.box, one.labels, metres=one.metres) for n, one in enumerate(readings)
    ]
    looks = {one.frame: (seen_from(100.0),) for one in named} | {15: (SeenColumns(0, WIDTH),)}
    return Tracks({"p1": tuple(named)}, looks)


def answer(plan, tracks, choices=()):
    return conclude(plan, tracks, rank(plan, tracks), choices, FRAMES).answer


VOTES = st.lists(st.dictionaries(st.sampled_from("abc"), st.sampled_from((-UNIT, 0.0, UNIT, 2 * UNIT))), max_size=6)


@pytest.mark.slow
@settings(max_examples=examples(200))
@given(VOTES)
def test_the_course_is_the_best_of_all_courses(votes):
    told = dict(enumerate(votes))
    values = sorted({value for one in votes for value in one})

    def odds(course):
        changes = sum(one != other for one, other in itertools.pairwise(course))
        return sum(one.get(value, 0.0) for one, value in zip(votes, course, strict=True)) - changes * CHANGE

    found = tuple(likeliest_course(told).values())
    if values:
        assert odds(found) == pytest.approx(max(map(odds, itertools.product(values, repeat=len(votes)))))
    else:
        assert not found


def test_a_reading_amid_others_is_no_change_and_the_last_one_is():
    read_once = woman(read(15, "standing"), read(60, "cycling"), read(105, "standing"), read(150, "sitting"))
    assert [*postures(read_once, "p1", 0).values()] == ["standing", "standing", "standing", "sitting"]
    twice = woman(read(15, "standing"), read(60, "cycling"), read(60, "cycling"), read(105, "standing"))
    assert [*postures(twice, "p1", 0).values()] == ["standing", "cycling", "standing"]


def test_a_posture_ends_where_it_stays_away():
    plan = reading_at(WOMAN, "next_action", "multiple_choice", event="end")
    course = woman(read(15, "standing"), read(60, "cycling"), read(105, "standing"), read(150, "sitting"))
    assert [*brackets(plan, course, "p1").values()] == [Bracket(105, 150, 15)]
    assert answer(plan, course, ("cycling", "sitting", "standing", "walking")) == Choice(2)


def test_seconds_to_an_event_that_was_not_seen_go_to_the_middle_of_the_time_left():
    times = {
        "t1": Time(event="start", action="sitting", after="t0"),
        "t2": Time(event="start", action="cycling", after="t1"),
    }
    spec = AnswerSpec("number", "seconds_between", "a", ("t1", "t2"))
    plan = Plan("a", "a", WOMAN.times | times, WOMAN.nodes, (), spec)
    sits = [read(15, "standing"), read(30, "sitting")]
    followed = woman(*sits, *(read(frame, "sitting") for frame in range(60, 481, 60)))
    middle = (480 + FRAMES[-1]) / 2
    assert answer(plan, followed) == Number(pytest.approx((middle - 22.5) / 15, abs=0.1))
    # It may be any number where the first event was not seen.
    assert answer(plan, woman(sits[0])) == Number(10.0)


def test_the_box_is_one_that_two_readings_agree_on():
    plan = reading_at(WOMAN, "action", "multiple_choice", 300)

    def shown(*readings):
        found = conclude(plan, tracks := woman(*readings), rank(plan, tracks), ("sitting", "walking"), FRAMES)
        return found.answer, found.frame, found.box.votes

    # The answer is read where it is asked for; the box may be of any frame.
    described = [read(15, "standing"), read(15, "standing")]
    assert shown(*described, read(300, "walking")) == (Choice(2), 15, 2)
    assert shown(*described, read(300, "walking"), read(300, "walking")) == (Choice(2), 15, 2)
    # Two readings that agree elsewhere are better than one at the frame of the description.
    assert shown(described[0], read(300, "walking"), read(300, "walking")) == (Choice(2), 300, 2)
    assert shown(described[0], read(300, "walking")) == (Choice(2), 15, 1)


def test_a_choice_that_is_no_number_of_people_is_passed_over():
    spec = AnswerSpec("multiple_choice", "attribute", "a", "t0", attribute="group_size")
    plan = Plan("a", "a", WOMAN.times, WOMAN.nodes, (), spec)
    alone = replace(read(15), labels=(ReadLabel("group_size", "1"),))
    assert answer(plan, woman(alone), ("9" * 5000, "many", "1")) == Choice(3)


def test_distances_that_contradict_each_other_are_read_a_third_time():
    plan = reading_at(WOMAN, "distance_change", "multiple_choice", 15, 90)
    alike = [read(frame, metres=3.0) for frame in (15, 15, 90, 90)]

    def look(*readings):
        tracks = woman(*readings)
        return next(iter(next_looks(plan, tracks, rank(plan, tracks), 4, FRAMES)), None)

    assert look(*alike) is None
    assert look(*alike[:3], read(90, metres=6.0)).frame == 90
