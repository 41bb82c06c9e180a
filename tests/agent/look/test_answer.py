"""The answer that is read from fused readings, and the course of what somebody does, against every course there is."""

import itertools
from collections import Counter
from dataclasses import replace

import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from readings import WOMAN, reading_at, toward

from jrdb_avr.agent.look.answer import CHANGES, conclude, guess_choice, nearest_postures
from jrdb_avr.agent.look.attention import next_looks
from jrdb_avr.agent.look.moments import CHANGE, Bracket, brackets, likeliest_course, postures
from jrdb_avr.agent.look.ranking import rank
from jrdb_avr.agent.perceive.geometry import SeenColumns, seen_from
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel
from jrdb_avr.agent.perceive.votes import UNIT, Tracks
from jrdb_avr.schema.answers import Choice, Number
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, POSES, PRESENCE_ANSWERS
from jrdb_avr.schema.panorama import WIDTH, Box
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time

FRAMES = range(0, 900)


def read(frame, *poses, observation="o", metres=None):
    labels = (ReadLabel("gender", "female"), *(ReadLabel("action", pose) for pose in poses))
    return PersonReading(observation, 1, frame, Box(toward(100.0), 100.0, 50.0, 150.0), labels, metres=metres)


def woman(*readings):
    named = [replace(one, observation=f"o{n}") for n, one in enumerate(readings)]
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
    lasting = woman(
        *(read(frame, pose) for frame, pose in ((15, "standing"), (60, "cycling"), (75, "cycling"), (90, "standing")))
    )
    assert [*postures(lasting, "p1", 0).values()] == ["standing", "cycling", "cycling", "standing"]


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


def test_the_evidence_is_a_whole_box_at_a_frame_of_the_description():
    plan = reading_at(WOMAN, "action", "multiple_choice", 300)

    def shown(*readings):
        conclusion = conclude(plan, tracks := woman(*readings), rank(plan, tracks), ("sitting", "walking"), FRAMES)
        return conclusion.answer, conclusion.frame

    # The answer is read where it is asked for; the box may be of any frame.
    described, later = read(15, "standing"), read(300, "walking")
    assert shown(described, later) == (Choice(2), 15)
    assert shown(replace(described, whole=False), later) == (Choice(2), 300)
    assert shown(replace(described, whole=False), replace(later, whole=False)) == (Choice(2), 15)
    assert shown(read(30, "standing"), read(60), later) == (Choice(2), 300)


ACTION = reading_at(WOMAN, "action", "multiple_choice", 15)
FIRST_LEFT = "first to the left of (robot view)"
HOLDS = Condition(object="bag", verb="holding", at="t0")
OFFERED = ("walking", "standing", "writing", "reading", "holding sth")


LABELS_READ = st.tuples(st.sampled_from(OFFERED), st.booleans(), st.sampled_from((0, 15, 30)))


@given(st.lists(LABELS_READ, min_size=1, max_size=6), st.permutations(OFFERED))
@settings(max_examples=examples(60))
def test_the_answer_is_the_offered_label_with_the_highest_log_odds(votes, choices):
    readings = [replace(read(at), labels=(ReadLabel("action", label, holds),)) for label, holds, at in votes]
    tracks = woman(*readings)
    odds = [tracks.statement("p1", "action", label, 15).log_odds for label in choices]
    conclusion = conclude(ACTION, tracks, rank(ACTION, tracks), choices, FRAMES)
    if max(odds) > 0:
        assert odds[conclusion.answer.choice - 1] == max(odds)
    elif not any(value > 0 for value in tracks.values("p1", "pose", 15).values()):
        assert (conclusion.answer, conclusion.verdict) == (guess_choice(choices), "guess")


@pytest.mark.parametrize(
    ("pose", "choices", "expected"),
    [
        ("standing", ("scooter", "cycling", "walking", "lying down"), "walking"),
        ("walking", ("sitting", "lying down", "bending"), "bending"),
        ("sitting", ("walking", "cycling", "standing"), "standing"),
    ],
)
def test_a_posture_that_is_not_offered_is_the_nearest_offered_one(pose, choices, expected):
    tracks = woman(read(15, pose))
    conclusion = conclude(ACTION, tracks, rank(ACTION, tracks), choices, FRAMES)
    assert choices[conclusion.answer.choice - 1] == expected and conclusion.verdict == "supported"


def test_a_guess_depends_on_the_choices_alone_and_favors_no_position():
    choices = ("scooter", "skating")
    for pose in ("sitting", "standing"):
        conclusion = conclude(ACTION, tracks := woman(read(15, pose)), rank(ACTION, tracks), choices, FRAMES)
        assert (conclusion.answer, conclusion.verdict) == (guess_choice(choices), "guess")
    picked = Counter(guess_choice([f"{n}", "a", "b", "c"]).choice for n in range(400))
    assert set(picked) == {1, 2, 3, 4} and min(picked.values()) > 60


def test_changes_of_postures_are_pairs_in_the_order_of_their_counts():
    pairs = [frozenset(pair) for *pair, _ in CHANGES]
    assert len(set(pairs)) == len(pairs) and all(len(pair) == 2 and pair <= set(POSES) for pair in pairs)
    counts = [count for *_, count in CHANGES]
    assert counts == sorted(counts, reverse=True) and counts[-1] > 0
    assert nearest_postures("bending") == ("standing", "walking", "sitting", "running", "cycling")
    assert nearest_postures("skating") == ()


def test_a_verdict_is_certain_only_if_person_and_answer_are():
    choices = ("walking", "standing", "sitting")

    def verdict(*readings, plan=ACTION, choices=choices, **others):
        tracks = woman(*readings)
        tracks = Tracks({**tracks.people, **others}, tracks.looks)
        return conclude(plan, tracks, rank(plan, tracks), choices, FRAMES).verdict

    stands, sits = read(15, "standing"), read(15, "sitting")
    tall = Plan("a", "a", ACTION.times, (Node("a", (*WOMAN.nodes[0].conditions, HOLDS)),), (), ACTION.answer)
    bag = replace(sits, labels=(*sits.labels, ReadLabel("object", "holding: bag")))
    assert verdict(bag, plan=tall) == "certain"
    # The gender alone fits many people, and standing is often read of people who walk.
    assert verdict(sits) == "supported"
    assert verdict(replace(bag, labels=(bag.labels[0], *stands.labels[1:], bag.labels[2])), plan=tall) == "supported"
    # Another woman is as likely, and small people are often read wrongly.
    assert verdict(bag, plan=tall, p2=(bag,)) == "supported"
    assert verdict(replace(bag, box=bag.box._replace(h=79.0)), plan=tall) == "supported"
    # Each further person who was read a little takes probability from the target.
    women = {f"p{n}": (sits,) for n in range(2, 9)}
    assert verdict(bag, plan=tall, p2=(sits,)) == "certain" and verdict(bag, plan=tall, **women) == "supported"
    # A missed person moves a chain.
    beside = replace(sits, box=sits.box._replace(x=sits.box.x - 200))
    for relation, expected in (("within 30 degrees to the left of (robot view)", "certain"), (FIRST_LEFT, "supported")):
        edges = (Edge("a", relation, "b", "t0"),)
        chain = Plan("a", "a", ACTION.times, (*tall.nodes, Node("b")), edges, ACTION.answer)
        assert verdict(bag, plan=chain, p2=(beside,)) == expected, relation
    # An open part of the plan, and an answer that was not read.
    assert verdict(replace(stands, labels=stands.labels[1:])) == "guess"
    assert verdict(read(15, "bending")) == "supported" and verdict(read(15)) == "guess"
    man = replace(stands, labels=(ReadLabel("gender", "male"), *stands.labels[1:]))
    assert verdict(man) == "guess"
    # An answer about times at which no look was made.
    gone = reading_at(WOMAN, "presence", "multiple_choice", 300, 600)
    assert verdict(read(15), plan=gone, choices=PRESENCE_ANSWERS) == "guess"
    assert verdict(read(15), read(300), read(600), plan=gone, choices=PRESENCE_ANSWERS) == "supported"


def test_a_choice_that_is_no_number_of_people_is_passed_over():
    spec = AnswerSpec("multiple_choice", "attribute", "a", "t0", attribute="group_size")
    plan = Plan("a", "a", WOMAN.times, WOMAN.nodes, (), spec)
    alone = replace(read(15), labels=(ReadLabel("group_size", "1"),))
    assert answer(plan, woman(alone), ("9" * 5000, "many", "1")) == Choice(3)


def test_a_distance_that_could_not_be_read_is_read_again():
    plan = reading_at(WOMAN, "distance_change", "multiple_choice", 15, 90)
    first, last, unread = read(15, metres=3.0), read(90, metres=6.0), read(90)

    def look(*readings):
        tracks = woman(*readings)
        return next(iter(next_looks(plan, tracks, rank(plan, tracks), 4, FRAMES)), None)

    assert look(first, last) is None
    assert look(first, unread).frame == 90
    assert answer(plan, woman(first, last), DISTANCE_ANSWERS) == Choice(2)
