"""The marker model plays ReAct and the methods with a fixed context on painted worlds: through pixels and a socket."""

import json
import threading
from dataclasses import replace

import pytest
from painted import Actor, World, still

from jrdb_avr.agent.methods.chain_of_thought import ChainOfThought
from jrdb_avr.agent.methods.monolithic import Monolithic
from jrdb_avr.agent.methods.react import ReAct
from jrdb_avr.agent.methods.search_recognize import SearchRecognize
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.policy.explorer import FixedExplorer, Look, Sighting
from jrdb_avr.agent.policy.state import EpisodeState
from jrdb_avr.agent.simulated.facts import known_facts, shown_there, write_facts
from jrdb_avr.agent.simulated.server import Server
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.panorama import WIDTH, Box, iou
from jrdb_avr.schema.plan import AnswerSpec, Condition, Node, Plan, Time
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


# -- looking ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "x", [-70, -69, -35, -1, 0, 10, 200, 1800, 2000, WIDTH - 71, WIDTH - 70, WIDTH - 35, WIDTH - 1, WIDTH, WIDTH + 40]
)
def test_react_wherever_the_person_stands(play, x):
    person = who(lambda f: Box(x, 120, 70, 220), until=90)
    prediction = play.change(ReAct, play.world([person, *CROWD[1:]], range(601)), [STANDING], t1=150)
    assert prediction.answer.choice == POSES.index("sitting") + 1
    check_box(prediction, person.box)


def test_react_boxes_nobody_if_no_mark_can_be_read(play):
    prediction = play.change(ReAct, play.world(CROWD, range(601)), [STANDING], t1=150)
    assert prediction.status == "invalid" and prediction.evidence is None
    assert prediction.answer is not None
    assert any("mark unreadable" in reason for reason in play.missing())


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
