"""What the simulated model sees with each knob: the rates of its faults, and on what they depend."""

import base64
import math
from collections import Counter

import cv2
import numpy as np
import pytest

from jrdb_avr.agent.simulated.confusion import confusions, label_of
from jrdb_avr.agent.simulated.knobs import Knobs
from jrdb_avr.agent.simulated.perception import Perception, PictureMarks, Reader
from jrdb_avr.agent.simulated.requests import MessagePart, Url, read_request
from jrdb_avr.schema.markers import ALONE, MAX_IDENTITY, Mark, Reading
from jrdb_avr.schema.panorama import Box, iou
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.things import OBJECTS, VERBS

N = 1000
CROP_SIZE = (480, 480)
HER = Mark(
    7, "female", "adolescence", "standing", ("reading",), 3, 50, 90, 9, "conversation", object=OBJECTS[3], verb=VERBS[1]
)
BOX = Box(100, 100, 100, 200)
QUESTION = "Who is it?"


def picture(number, *people, size=CROP_SIZE):
    """A picture whose bytes have this hash, and the marks in it."""
    return PictureMarks(number.to_bytes(4, "big"), size, tuple(Reading(mark, box, True) for mark, box in people))


def seen(knobs, shown, question=QUESTION, statements=(), age=0):
    return Perception(knobs, question, statements).readings(shown, age)


def share_seen(knobs, height, size=CROP_SIZE, others=(), age=0):
    box = Box(100, 400 - height, height / 3, height)
    shown = (picture(n, (HER, box), *others, size=size) for n in range(N))
    return sum(any(r.mark.identity == 7 for r in seen(knobs, one, age=age)) for one in shown) / N


def near(share, rate, draws=N):
    """Four standard deviations: fixed seeds make it all or never."""
    return abs(share - rate) < 4 * math.sqrt(max(rate * (1 - rate), 1e-9) / draws) + 1e-9


def test_without_knobs_every_mark_is_read_as_it_is():
    shown = picture(1, (HER, BOX), (Mark(8), Box(0, 0, 20, 40)))
    assert seen(Knobs(seed=9, latency=3.0), shown, age=5) == shown.readings


# -- whom it sees -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("height", "rate"), [(100, 0.2), (200, 0.1), (50, 0.4), (20, 1.0)])
def test_misses_grow_as_people_are_smaller(height, rate):
    assert near(share_seen(Knobs(miss=0.2), height), 1 - rate)


@pytest.mark.parametrize("age", [0, 1, 3])
def test_older_pictures_are_forgotten(age):
    assert near(share_seen(Knobs(forget=0.3), 100, age=age), 0.7**age)


def test_ghosts_stand_in_their_share_of_pictures():
    shown = [seen(Knobs(ghosts=0.2), picture(n, (HER, BOX))) for n in range(N)]
    ghosts = [reading for readings in shown for reading in readings if reading.mark.identity > MAX_IDENTITY]
    assert near(len(ghosts) / N, 0.2)
    assert {len(readings) for readings in shown} == {1, 2}
    assert all(readings == tuple(sorted(readings, key=lambda one: one.box.x)) for readings in shown)
    assert all(g.box.x >= 0 and g.box.x + g.box.w <= 480 and 0 <= g.box.y <= 480 - g.box.h for g in ghosts)
    assert len({ghost.mark for ghost in ghosts}) == len(ghosts), "each is somebody else"
    assert {ghost.mark.group for ghost in ghosts} == {ALONE}


# -- where ------------------------------------------------------------------------------------------------------------


def test_sides_of_boxes_jitter_with_a_heavy_tail():
    boxes = [seen(Knobs(jitter=0.05), picture(n, (HER, BOX)))[0].box for n in range(N)]
    moved = sorted(abs(box.x - BOX.x) / BOX.w for box in boxes)
    # Student's t with two degrees of freedom: half of it within 0.8165 scales, 1.03 % beyond 9.7.
    assert moved[N // 2] == pytest.approx(0.05 * 0.8165, rel=0.15)
    assert 1 <= sum(share > 0.05 * 9.7 for share in moved) <= 30
    assert sum(iou(box, BOX) > 0.5 for box in boxes) > 0.9 * N
    assert all(box.x >= 0 and box.x + box.w <= 480 and box.w >= 2 and box.h >= 2 for box in boxes)


# -- what it reads ----------------------------------------------------------------------------------------------------


def marks(knobs, number=N, mark=HER, **more):
    return [seen(knobs, picture(n, (mark, BOX)), **more)[0].mark for n in range(number)]


def test_labels_are_confused_with_those_that_look_alike():
    read = marks(Knobs(confuse=0.3, seed=2))
    for name in ("gender", "age", "pose", "actions", "distance"):
        own = label_of(HER, name)
        wrong = [label_of(mark, name) for mark in read if label_of(mark, name) != own]
        assert near(len(wrong) / N, 0.3), name
        assert set(wrong) == set(confusions(0.3, name, own)), name
    assert {label_of(mark, "age") for mark in read} == {"childhood", "adolescence", "young adulthood"}
    assert {mark.heading_deg for mark in read} == {90} and {mark.identity for mark in read} == {7}


def test_a_matrix_gives_each_label_its_share():
    row = {"walking": 0.3, "sitting": 0.1}
    read = Counter(mark.pose for mark in marks(Knobs(confuse={"pose": {"standing": row}})))
    assert set(read) == {"standing", *row}
    assert near(read["walking"] / N, 0.3) and near(read["sitting"] / N, 0.1)
    assert {mark.gender for mark in marks(Knobs(confuse={"pose": {"standing": row}}))} == {"female"}


@pytest.mark.slow
@pytest.mark.parametrize("knob", ["wrong_attribute", "confuse"])
@pytest.mark.parametrize("correlated", [0.0, 0.6, 1.0])
def test_correlated_misreadings_are_the_persons_and_the_rate_stays(knob, correlated):
    """Of many people in two pictures each: who is misread, and who is misread alike in both."""
    rate, people = 0.2, 3000
    knobs = Knobs(**{knob: rate}, correlated=correlated)
    wrong = []
    for identity in range(people):
        mark = Mark(identity, gender="female", pose="standing")
        wrong.append([seen(knobs, picture(n, (mark, BOX)))[0].mark.gender != "female" for n in (1, 2)])
    assert near(sum(map(sum, wrong)) / 2 / people, rate, people)
    lasting = rate * correlated
    fleeting = (rate - lasting) / (1 - lasting)
    assert near(sum(map(all, wrong)) / people, lasting + (1 - lasting) * fleeting**2, people)


STATEMENTS = (
    Condition(action="sitting", at="t0"),
    Condition(action="typing", at="t0"),
    Condition(attribute="gender", value="male"),
    Condition(attribute="distance", value="far", at="t0"),
    Condition(interaction="hugging", at="t0"),
    Condition(object=OBJECTS[5], verb=VERBS[2], at="t0"),
)


def test_statements_of_the_prompt_are_affirmed_each_by_itself():
    read = marks(Knobs(please=0.2), statements=STATEMENTS)
    rates = {
        "sitting": sum(mark.pose == "sitting" for mark in read),
        "typing": sum("typing" in mark.actions for mark in read),
        "male": sum(mark.gender == "male" for mark in read),
        "far": sum(label_of(mark, "distance") == "far" for mark in read),
        "hugging": sum(mark.interaction == "hugging" for mark in read),
        "object": sum((mark.object, mark.verb) == (OBJECTS[5], VERBS[2]) for mark in read),
    }
    assert all(near(count / N, 0.2) for count in rates.values()), rates
    assert marks(Knobs(please=1.0), 5) == [HER] * 5, "no statement, nothing to affirm"


# -- replays ----------------------------------------------------------------------------------------------------------

ALL = Knobs(
    wrong_attribute=0.3, confuse=0.3, correlated=0.5, miss=0.2, pixels=10**5, ghosts=0.3, please=0.2, jitter=0.1,
    forget=0.2, seed=4,
)  # fmt: skip


def test_what_is_seen_depends_on_seed_question_and_picture_alone():
    shown = [picture(n, (HER, BOX), (Mark(8, pose="sitting"), Box(300, 200, 60, 150))) for n in range(60)]
    first = [seen(ALL, one, statements=STATEMENTS) for one in shown]
    again = {n: seen(ALL, shown[n], statements=STATEMENTS) for n in reversed(range(60))}
    assert first == [again[n] for n in range(60)]
    assert first != [seen(ALL, one, "another", STATEMENTS) for one in shown]
    assert first != [seen(Knobs(wrong_attribute=0.3, seed=5), one) for one in shown]
    assert len(set(first)) > 50, "pictures differ"


# -- how old a picture is ---------------------------------------------------------------------------------------------

STAGE = "Your next turn, as one JSON object:"
HEADING = (
    "Question: Find the only person who is standing at 1.0 s (frame 15). "
    "Which of these is that person doing at 4.0 s (frame 60)? Only one is true."
)


def grey():
    """A picture of nobody."""
    jpeg = cv2.imencode(".jpg", np.full((480, 480, 3), 96, np.uint8))[1].tobytes()
    return MessagePart(image_url=Url("data:image/jpeg;base64," + base64.b64encode(jpeg).decode()))


def ages(*messages, last=""):
    """The ages at which the pictures of user messages are seen; a message is the lines before its pictures."""
    turns = [[MessagePart(HEADING), *(p for line in lines for p in (MessagePart(line), grey()))] for lines in messages]
    turns[-1] += [MessagePart(last), MessagePart(STAGE)]
    found = []

    class Recording(Perception):
        def readings(self, picture, age=0):
            found.append(age)
            return ()

    read_request(turns, Reader(), [STAGE], lambda *about: Recording(Knobs(), *about))
    return found


def line(frame):
    return f'Picture 1: {{"frame_id": "{frame:06d}", "angle_deg": 180.0, "left": 1640}}'


def test_a_chats_pictures_are_as_old_as_the_turns_since():
    assert ages([line(0), line(1)], [line(2)], []) == [2, 2, 1]
