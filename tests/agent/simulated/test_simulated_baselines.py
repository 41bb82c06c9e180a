"""The marker model plays the methods with a fixed context on painted worlds, through pixels and a socket."""

import json
import threading
from dataclasses import replace

import pytest
from painted import Actor, World, still

from jrdb_avr.agent.methods.chain_of_thought import ChainOfThought
from jrdb_avr.agent.methods.monolithic import Monolithic
from jrdb_avr.agent.methods.search_recognize import SearchRecognize
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.policy.explorer import FixedExplorer, Look, Sighting
from jrdb_avr.agent.policy.state import EpisodeState
from jrdb_avr.agent.simulated.facts import known_facts, shown_there, write_facts
from jrdb_avr.agent.simulated.knobs import Knobs
from jrdb_avr.agent.simulated.server import Server
from jrdb_avr.schema.answers import frames_iou
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.panorama import WIDTH, Box, angle_error, iou
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import FIRST_RIGHT, SAME_GROUP
from jrdb_avr.schema.things import OBJECTS
from jrdb_avr.schema.wording.people import in_order
from jrdb_avr.schema.wording.text import render

POSES = ("walking", "sitting", "standing", "lying")
SHOWN = tuple(range(0, 106, 15))
"""Eight frames: the panoramas of every method are all that there is."""

TWO = (15, 90)

SPARSE = tuple(range(0, 701, 5))
"""Of these frames 0, 100, 200 ... 700 are shown."""

FIXED = (Monolithic, ChainOfThought)


class Play:
    def __init__(self, folder, knobs=None):
        self.folder = folder
        self.log = folder / "marker.jsonl"
        self.server = Server(log=self.log) if knobs is None else Server(log=self.log, knobs=knobs)
        threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        self.worlds = 0

    def world(self, actors, frames=SHOWN):
        self.worlds += 1
        return World(self.folder / f"world{self.worlds}", actors, frames)

    def ask(self, method, world, template, conditions, spec, times, choices=(), edges=(), steps=None):
        times = {name: Time(frame=t) if isinstance(t, int) else t for name, t in times.items()}
        people = ["a", *dict.fromkeys(edge.target for edge in edges)]
        nodes = tuple(Node(id=name, conditions=in_order(conditions) if name == "a" else ()) for name in people)
        plan = Plan(root="a", target=spec.of, times=times, nodes=nodes, edges=tuple(edges), answer=spec)
        task = world.task(render(template, plan, "0" * 64), spec.mode, choices, steps)
        return method(Client(self.server.url, "marker")).answer(task)

    def change(self, method, world, conditions, t0=15, t1=90, **more):
        spec = AnswerSpec(mode="multiple_choice", read="action", of="a", at="t1")
        return self.ask(method, world, "change", conditions, spec, {"t0": t0, "t1": t1}, POSES, **more)

    def missing(self):
        return json.loads(self.log.read_text().splitlines()[-1])["missing"]


@pytest.fixture
def play(tmp_path):
    made = Play(tmp_path)
    yield made
    made.server.shutdown()
    made.server.server_close()


STANDING = Condition(action="standing", at="t0")
FEMALE = Condition(attribute="gender", value="female")
CROWD = [
    still(300, 21, pose="walking", gender="male", group=0, distance_dm=60),
    still(1200, 22, pose="walking", gender="male", group=0, distance_dm=60),
    still(3000, 24, pose="walking", gender="female", group=0, distance_dm=60),
]


def who(box, until=60, before="standing", after="sitting", **mark):
    mark = {"gender": "female", "group": 0, "distance_dm": 50, **mark}
    return Actor(box, lambda frame: Mark(7, pose=before if frame < until else after, **mark))


def first_reply(steps):
    return json.loads(json.loads(next(step.response for step in steps if step.kind == "model"))["content"])


def check_box(prediction, box, least=0.9):
    assert prediction.status == "answered", prediction
    assert iou(Box(*prediction.evidence.box), box(prediction.evidence.frame)) >= least


# -- all at once ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", FIXED)
def test_change(play, method):
    steps = []
    prediction = play.change(
        method, play.world([who(lambda f: Box(1800, 120, 71, 220)), *CROWD]), [STANDING], steps=steps
    )
    assert (prediction.status, prediction.answer.choice) == ("answered", POSES.index("sitting") + 1)
    assert prediction.evidence.frame == 15, "where it was recognized"
    # A thousandth of a panorama is 3.76 columns, and half a cell of the mark two pixels.
    assert prediction.evidence.box == pytest.approx((1800, 120, 71, 220), abs=5)
    assert play.missing() == []
    if method is ChainOfThought:
        facts = first_reply(steps)["reasoning"]
        assert len(facts) == 8 and "Frame 000015" in facts[1] and "female" in facts[1] and "standing" in facts[1]
        assert "Frame 000090" in facts[6] and "sitting" in facts[6]


@pytest.mark.parametrize(("x", "part"), [(3700, Box(3700, 120, 60, 220)), (3740, Box(0, 120, 60, 220))])
def test_of_a_person_over_the_seam_the_larger_part_is_boxed(play, x, part):
    prediction = play.change(Monolithic, play.world([who(lambda f: Box(x, 120, 80, 220)), *CROWD], TWO), [STANDING])
    assert prediction.answer.choice == 2
    assert iou(Box(*prediction.evidence.box), part) > 0.9
    assert iou(Box(*prediction.evidence.box), Box(x, 120, 80, 220)) > 0.6


def test_of_several_pictures_one_that_shows_the_person_whole_is_given(play):
    def box(frame):
        return Box(3720 if frame < 60 else 3600, 120, 80, 220)

    world = play.world([who(box), *CROWD])
    prediction = play.change(ChainOfThought, world, [STANDING])
    assert prediction.evidence.frame == 60
    check_box(prediction, box)
    once = play.change(Monolithic, world, [STANDING])
    assert once.evidence.frame == 15, "read once, where the person was recognized"


def test_nobody_who_fits_is_no_box_and_the_answer_is_a_guess(play):
    prediction = play.change(Monolithic, play.world(CROWD, TWO), [STANDING])
    assert prediction.status == "invalid" and prediction.evidence is None
    assert prediction.answer.choice in range(1, 5)
    assert any("nobody who was read fits" in reason for reason in play.missing())


def test_between_two_panoramas_the_nearest_one_is_taken_and_that_is_told(play):
    """Standing at frame 140, the person has sat down in the panorama at 100; being female, she may be the one."""

    def mark(frame):
        return Mark(7, pose="sitting" if frame < 120 or frame > 300 else "standing", gender="female", distance_dm=50)

    person = Actor(lambda f: Box(1800, 120, 70, 220), mark)
    others = [still(300, 21, pose="standing", gender="male"), still(900, 22, pose="walking", gender="male")]
    prediction = play.change(Monolithic, play.world([person, *others], SPARSE), [STANDING, FEMALE], t0=140, t1=380)
    assert prediction.answer.choice == POSES.index("sitting") + 1
    check_box(prediction, person.box)
    assert play.missing()[-2:] == ["not shown: t0", "not shown: t1"]


def test_who_is_not_in_the_nearest_panorama_is_sought_in_others(play):
    person = who(lambda f: Box(1800, 120, 70, 220) if f > 250 else None, until=900)
    world = play.world([person, CROWD[0]], SPARSE)
    prediction = play.change(ChainOfThought, world, [STANDING, FEMALE], t0=140, t1=380)
    assert prediction.answer.choice == POSES.index("standing") + 1
    check_box(prediction, person.box)
    once = play.change(Monolithic, world, [STANDING, FEMALE], t0=140, t1=380)
    assert once.evidence is None and any("nobody who was read fits" in reason for reason in play.missing())


class Retold:
    """A client that changes a word of the facts before they are sent back."""

    def __init__(self, client, before, after):
        self.client, self.words = client, (before, after)

    def complete(self, messages, schema=None):
        retold = [
            replace(
                message, parts=tuple(self.retell(part) if isinstance(part, str) else part for part in message.parts)
            )
            for message in messages
        ]
        return self.client.complete(retold, schema)

    def retell(self, text):
        return text.replace(*self.words) if text.startswith("Fact 1: ") else text


def test_a_chain_of_thought_answers_from_its_facts_and_not_from_a_second_look(play):
    world = play.world([who(lambda f: Box(1800, 120, 71, 220)), *CROWD])
    prediction = play.change(lambda client: ChainOfThought(Retold(client, "sitting", "lying")), world, [STANDING])
    assert prediction.answer.choice == POSES.index("lying") + 1
    check_box(prediction, lambda frame: Box(1800, 120, 71, 220))
    prediction = play.change(lambda client: ChainOfThought(Retold(client, "Frame", "Moment")), world, [STANDING])
    assert prediction.evidence is None, "no fact tells of anybody"


def test_facts_are_read_back_as_they_were_written():
    mark = Mark(1, "female", "adolescence", "standing", ("reading", "pushing"), None, 57, None, None, "hugging")
    for told in (mark, replace(mark, object=OBJECTS[3], verb="pushing", interaction=None), Mark(1)):
        look = Look(15, 180.0, (Sighting(15, told, Box(10, 20, 30, 40), True, 91.0),), panorama=True)
        state = EpisodeState(None, (), FixedExplorer([look]))
        state.plan = Plan("a", "a", {}, (), (), AnswerSpec(mode="frame", read="start", of="a", at="t1"))
        state.note("not shown: t1")
        lines = [f"Fact {n}: {fact}" for n, fact in enumerate(write_facts(state, look.sightings[0]), 1)]
        known = known_facts(lines, [look])
        assert [(s.mark, s.frame, s.angle) for s in known.looks[0].sightings] == [(told, 15, 91.0)]
        assert known.missing == ("not shown: t1",) and known.counted is None
        assert shown_there(known.looks[0].sightings[0], [look]) == (look, look.sightings[0])
    assert known_facts(["Panorama 1: {}"], [look]) is None


@pytest.mark.parametrize("there", [(True, True), (True, False), (False, True), (False, False)])
def test_presence(play, there):
    def box(frame):
        return Box(1800, 120, 70, 220) if frame < 30 or there[frame > 75] else None

    spec = AnswerSpec(mode="multiple_choice", read="presence", of="a", at=("t1", "t2"))
    times = {"t0": 15, "t1": 60, "t2": 105}
    prediction = play.ask(
        Monolithic, play.world([who(box), *CROWD], (15, 60, 105)), "presence", [STANDING], spec, times, PRESENCE_ANSWERS
    )
    assert prediction.answer.choice == {(1, 1): 1, (1, 0): 2, (0, 1): 3, (0, 0): 4}[there]
    check_box(prediction, box)


@pytest.mark.parametrize(("later", "expected"), [(30, 1), (70, 2), (53, 3), (None, 4)])
def test_distance(play, later, expected):
    def box(frame):
        return Box(500, 120, 70, 220) if frame < 60 or later is not None else None

    actor = Actor(box, lambda f: Mark(7, pose="standing", distance_dm=50 if f < 60 else later))
    spec = AnswerSpec(mode="multiple_choice", read="distance_change", of="a", at=("t0", "t1"))
    times = {"t0": 15, "t1": 90}
    prediction = play.ask(
        Monolithic, play.world([actor, *CROWD], TWO), "distance", [STANDING], spec, times, DISTANCE_ANSWERS
    )
    assert prediction.answer.choice == expected
    check_box(prediction, box)


# -- events between panoramas -----------------------------------------------------------------------------------------


def start_of(action, after="t0"):
    return Time(event="start", of="a", action=action, after=after)


@pytest.mark.parametrize("method", FIXED)
def test_a_start_lies_in_the_middle_between_two_panoramas(play, method):
    person = who(lambda f: Box(1700 + f, 120, 70, 220), until=210)
    spec = AnswerSpec(mode="frame", read="start", of="a", at="t1")
    times = {"t0": 100, "t1": start_of("sitting")}
    prediction = play.ask(method, play.world([person, *CROWD], SPARSE), "start", [STANDING], spec, times)
    assert prediction.answer.frame == 250
    check_box(prediction, person.box)


def test_a_span_lies_between_panoramas(play):
    person = Actor(
        lambda f: Box(1700, 120, 70, 220),
        lambda f: Mark(7, pose="sitting" if 210 <= f <= 480 else "standing", gender="female", distance_dm=50),
    )
    spec = AnswerSpec(mode="span", read="span", of="a", at=("t1", "t2"))
    times = {"t0": 100, "t1": start_of("sitting"), "t2": Time(event="end", of="a", action="sitting", after="t1")}
    prediction = play.ask(Monolithic, play.world([person, *CROWD], SPARSE), "span", [STANDING], spec, times)
    assert (prediction.answer.start_frame, prediction.answer.end_frame) == (250, 450)
    assert frames_iou(prediction.answer, type(prediction.answer)(210, 480)) > 0.5


def test_seconds_between_two_starts(play):
    person = Actor(
        lambda f: Box(1700, 120, 70, 220),
        lambda f: Mark(7, pose="sitting" if f >= 210 else "standing", actions=("reading",) if f > 520 else ()),
    )
    spec = AnswerSpec(mode="number", read="seconds_between", of="a", at=("t1", "t2"))
    times = {"t0": 100, "t1": start_of("sitting"), "t2": start_of("reading")}
    prediction = play.ask(Monolithic, play.world([person, *CROWD], SPARSE), "gap", [STANDING], spec, times)
    assert prediction.answer.value == pytest.approx((550 - 250) / 15, abs=0.06)


def test_seconds_of_an_absence(play):
    person = who(lambda f: Box(1700, 120, 70, 220) if not 210 < f < 480 else None, until=1000)
    spec = AnswerSpec(mode="number", read="seconds_between", of="a", at=("t1", "t2"))
    times = {
        "t0": 100,
        "t1": Time(event="leaves", of="a", after="t0"),
        "t2": Time(event="returns", of="a", after="t1"),
    }
    prediction = play.ask(Monolithic, play.world([person, *CROWD], SPARSE), "gap", [STANDING], spec, times)
    assert prediction.answer.value == pytest.approx((450 - 250) / 15, abs=0.06)
    check_box(prediction, person.box)


def test_a_count_of_all_who_are_seen(play):
    def member(number, first):
        return Actor(
            lambda f: Box(400 + 400 * number, 120, 70, 220) if f >= first else None,
            lambda f: Mark(30 + number, pose="walking", group=4, distance_dm=60),
        )

    person = who(lambda f: Box(1800, 400 - 220, 70, 220), group=4, until=10_000)
    spec = AnswerSpec(mode="number", read="count", of="a", at=("t1", "t2"), relation=SAME_GROUP)
    actors = [person, member(1, 0), member(2, 30), member(4, 0), member(5, 60), CROWD[0]]
    at_t1 = Condition(action="standing", at="t1")
    prediction = play.ask(Monolithic, play.world(actors), "gap", [at_t1], spec, {"t1": 0, "t2": 105})
    assert prediction.answer.value == 4


def test_hops_are_walked_in_the_panorama(play):
    actors = [
        who(lambda f: Box(3500, 120, 70, 220)),
        still(3700, 8, pose="walking", gender="male", distance_dm=40),
        still(120, 9, pose="lying", gender="male", distance_dm=40),
        still(1500, 10, pose="sitting", gender="male", distance_dm=40),
    ]
    edges = [Edge("a", FIRST_RIGHT, "b", "t0"), Edge("b", FIRST_RIGHT, "c", "t0")]
    spec = AnswerSpec(mode="multiple_choice", read="action", of="c", at="t0")
    for method in (*FIXED, SearchRecognize):
        prediction = play.ask(method, play.world(actors, TWO), "two_hop", [FEMALE], spec, {"t0": 15}, POSES, edges)
        assert prediction.answer.choice == POSES.index("lying") + 1
        check_box(prediction, actors[2].box)


def test_a_viewpoint_is_where_the_person_is_seen_next_to_the_moment(play):
    def box(frame):
        return Box(400 + 3 * frame, 120, 70, 220)

    actors = [
        still(2600, 5, pose="standing", gender="female", distance_dm=50),
        still(3000, 6, pose="walking", gender="male", distance_dm=50),
        Actor(box, lambda f: Mark(7, pose="sitting" if f >= 310 else "walking", gender="male", distance_dm=50)),
    ]
    edges = [Edge("a", FIRST_RIGHT, "b", "t0"), Edge("b", FIRST_RIGHT, "c", "t0")]
    spec = AnswerSpec(mode="frame_viewpoint", read="start_view", of="c", at="t1")
    times = {"t0": 0, "t1": Time(event="start", of="c", action="sitting", after="t0")}
    actors[2].box = lambda f: Box(3300 + f, 120, 70, 220)
    prediction = play.ask(Monolithic, play.world(actors, SPARSE), "action_search", [FEMALE], spec, times, edges=edges)
    assert prediction.answer.frame == 350
    assert angle_error(prediction.answer.angle_deg, (3300 + 350 + 35) * 360 / WIDTH) < 6


# -- search, then recognize -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("x", [1800, 3700, -30])
def test_search_refines_the_box_in_its_crop(play, x):
    steps = []
    person = who(lambda f: Box(x, 120, 33, 90), until=0, after="sitting")
    prediction = play.change(
        SearchRecognize, play.world([person, *CROWD], TWO), [Condition(action="sitting", at="t0")], steps=steps
    )
    check_box(prediction, person.box, 0.95)
    # The one frame that it sees at last is that of the description.
    assert prediction.n_model_calls == 3 and prediction.evidence.frame == 15
    assert prediction.answer.choice == POSES.index("sitting") + 1
    assert "not shown: t1" in play.missing()


def test_search_without_a_person_proposes_no_box(play):
    prediction = play.change(SearchRecognize, play.world(CROWD, TWO), [STANDING])
    assert prediction.status == "invalid" and "exactly one box" in prediction.reason
    # Two proposals, and the answer from the panoramas, also twice.
    assert prediction.n_model_calls == 4


@pytest.mark.slow
def test_a_proposal_beside_the_person_is_mended_in_the_crop(tmp_path):
    play = Play(tmp_path, Knobs(wrong_box=0.5, seed=4))
    mended = spoiled = 0
    for number in range(10):
        truth, steps = Box(600 + 250 * number, 120, 70, 220), []
        person = who(lambda _, truth=truth: truth, until=900)
        prediction = play.change(SearchRecognize, play.world([person], TWO), [STANDING], steps=steps)
        proposal = first_reply(steps)["evidence_bboxes"][0]["bbox"]
        beside = abs(proposal[0] * WIDTH / 1000 - truth.x) > 0.5 * truth.w
        right = iou(Box(*prediction.evidence.box), truth) > 0.9
        mended += beside and right
        spoiled += beside and not right
    play.server.shutdown()
    play.server.server_close()
    assert mended and spoiled, "the crop shows the person all the same, and its box may be wrong there too"
