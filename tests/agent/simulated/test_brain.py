"""The simulated model plays every method without a world model on painted worlds, through requests and a socket."""

import threading
from functools import partial

import pytest
from painted import Actor, World, still

from jrdb_avr.agent.methods.chain_of_thought import ChainOfThought
from jrdb_avr.agent.methods.monolithic import Monolithic
from jrdb_avr.agent.methods.react import ReAct
from jrdb_avr.agent.methods.search_recognize import SearchRecognize
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.simulated.profiles import PERFECT, PROFILES
from jrdb_avr.agent.simulated.server import Server
from jrdb_avr.engine.run.methods import make_method
from jrdb_avr.schema.panorama import WIDTH, Box, iou
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.wording.people import in_order
from jrdb_avr.schema.wording.text import render

POSES = ("walking", "sitting", "standing", "lying")
SHOWN = tuple(range(0, 106, 15))
"""Eight frames: the panoramas of every method are all that there is."""
TWO = (15, 90)
SPARSE = tuple(range(0, 701, 5))
"""Of these, frames 0, 100, 200 ... 700 are shown."""
PAPER = [partial(method, prompts="paper") for method in (Monolithic, ChainOfThought)]
FIXED = (Monolithic, ChainOfThought)


def no_world(chat):
    return make_method("agent-no-world", chat, CONTRACT)


LOOKING = (ReAct, no_world)


class Play:
    def __init__(self, folder, errors):
        self.folder, self.errors, self.servers = folder, errors, []

    def world(self, actors, frames=SHOWN):
        return World(self.folder / f"world{len(self.servers)}", actors, frames)

    def ask(self, method, world, template, conditions, spec, times, choices=(), edges=(), steps=None):
        times = {name: Time(frame=t) if isinstance(t, int) else t for name, t in times.items()}
        people = ["a", *dict.fromkeys(edge.target for edge in edges)]
        nodes = tuple(Node(id=name, conditions=in_order(conditions) if name == "a" else ()) for name in people)
        plan = Plan(root="a", target=spec.of, times=times, nodes=nodes, edges=tuple(edges), answer=spec)
        task = world.task(render(template, plan, "0" * 64), spec.mode, choices, steps)
        server = Server(world, self.errors)
        self.servers.append(server)
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        return method(Client(server.url, "simulated", EndpointOptions(simulated=True))).answer(task)

    def change(self, method, world, conditions, t0=15, t1=90, **more):
        spec = AnswerSpec(mode="multiple_choice", read="action", of="a", at="t1")
        return self.ask(method, world, "change", conditions, spec, {"t0": t0, "t1": t1}, POSES, **more)


@pytest.fixture
def play(tmp_path):
    made = Play(tmp_path, PERFECT)
    yield made
    for server in made.servers:
        server.shutdown()
        server.server_close()


STANDING = Condition(action="standing", at="t0")
CROWD = [
    still(300, 21, pose="walking", gender="male", metres=6.0),
    still(1200, 22, pose="walking", gender="male", metres=6.0),
    still(3000, 24, pose="walking", gender="female", metres=6.0),
]


def changing(box, until=60, before="standing", after="sitting", **labels):
    labels = {"gender": "female", **labels}
    return Actor(7, box, lambda frame: {**labels, "pose": before if frame < until else after})


def check_box(prediction, box, least=0.9):
    assert prediction.status == "answered", prediction
    assert iou(Box(*prediction.evidence.box), box(prediction.evidence.frame)) >= least


@pytest.mark.parametrize("method", LOOKING)
@pytest.mark.parametrize("x", [-35, 0, 1800, WIDTH - 35])
def test_a_person_is_found_and_followed_anywhere(play, method, x):
    person = changing(lambda frame: Box(x, 120, 70, 220), until=90)
    prediction = play.change(method, play.world([person, *CROWD[1:]], range(601)), [STANDING], t1=150)
    assert prediction.answer.choice == POSES.index("sitting") + 1
    check_box(prediction, person.box)


@pytest.mark.parametrize("method", LOOKING)
def test_if_no_person_is_read_the_answer_is_a_guess_without_a_box(play, method):
    prediction = play.change(method, play.world([], range(0, 301, 5)), [STANDING], t1=150)
    assert prediction.evidence is None and prediction.answer.choice in range(1, 5)
    again = play.change(method, play.world([], range(0, 301, 5)), [STANDING], t1=150)
    assert again.answer == prediction.answer


@pytest.mark.parametrize("method", LOOKING)
def test_relations_are_followed(play, method):
    """From the standing one to the left, and on to the left."""
    people = [
        still(x, n, pose=pose) for n, (x, pose) in enumerate(((1800, "standing"), (1500, "lying"), (1200, "sitting")))
    ]
    spec = AnswerSpec(mode="multiple_choice", read="action", of="c", at="t0")
    left = "first to the left of (robot view)"
    edges = [Edge(source=source, relation=left, target=target, at="t0") for source, target in ("ab", "bc")]
    world = play.world([*people, still(2200, 9, pose="walking")], range(0, 301, 5))
    prediction = play.ask(method, world, "two_hop", [STANDING], spec, {"t0": 15}, POSES, edges)
    assert prediction.answer.choice == POSES.index("sitting") + 1
    check_box(prediction, people[2].box)


@pytest.mark.parametrize("method", LOOKING)
def test_a_start_is_bracketed(play, method):
    person = changing(lambda frame: Box(1700 + frame / 2, 120, 70, 220), until=210)
    spec = AnswerSpec(mode="frame", read="start", of="a", at="t1")
    times = {"t0": 15, "t1": Time(event="start", of="a", action="sitting", after="t0")}
    prediction = play.ask(method, play.world([person, *CROWD], range(0, 451, 5)), "start", [STANDING], spec, times)
    assert abs(prediction.answer.frame - 210) <= 15
    check_box(prediction, person.box)


# -- fixed pictures ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", [*FIXED, *PAPER])
def test_panoramas_that_show_all_that_is_asked(play, method):
    steps = []
    world = play.world([changing(lambda frame: Box(1800, 120, 71, 220)), *CROWD])
    prediction = play.change(method, world, [STANDING], steps=steps)
    assert (prediction.status, prediction.answer.choice) == ("answered", POSES.index("sitting") + 1)
    # A thousandth of a panorama is 3.76 columns.
    assert prediction.evidence.box == pytest.approx((1800, 120, 71, 220), abs=5)
    if method is ChainOfThought:
        assert any("shows the person at panorama angle" in step.response for step in steps)


@pytest.mark.parametrize(("x", "part"), [(3700, Box(3700, 120, 60, 220)), (3740, Box(3740, 120, 20, 220))])
def test_of_a_person_over_the_seam_one_part_is_boxed(play, x, part):
    world = play.world([changing(lambda frame: Box(x, 120, 80, 220)), *CROWD], TWO)
    prediction = play.change(Monolithic, world, [STANDING])
    assert prediction.answer.choice == 2
    assert iou(Box(*prediction.evidence.box), Box(x, 120, 80, 220)) > 0.45


@pytest.mark.parametrize("method", FIXED)
def test_a_start_is_between_two_panoramas(play, method):
    person = changing(lambda frame: Box(1700 + frame, 120, 70, 220), until=210)
    spec = AnswerSpec(mode="frame", read="start", of="a", at="t1")
    times = {"t0": 100, "t1": Time(event="start", of="a", action="sitting", after="t0")}
    prediction = play.ask(method, play.world([person, *CROWD], SPARSE), "start", [STANDING], spec, times)
    assert 200 <= prediction.answer.frame <= 300
    check_box(prediction, person.box)


@pytest.mark.parametrize(("x", "prompts"), [(1800, "default"), (3700, "default"), (-30, "default"), (-30, "paper")])
def test_search_refines_the_box_in_its_crop(play, x, prompts):
    person = changing(lambda frame: Box(x, 120, 33, 90), until=0)
    world = play.world([person, *CROWD], TWO)
    prediction = play.change(partial(SearchRecognize, prompts=prompts), world, [Condition(action="sitting", at="t0")])
    check_box(prediction, person.box, 0.95)
    assert prediction.n_model_calls == 3
    assert prediction.answer.choice == POSES.index("sitting") + 1


# -- errors -----------------------------------------------------------------------------------------------------------


def test_equal_runs_are_equal_and_another_seed_is_not(tmp_path):
    crowd = [
        still(300 + 250 * n, 20 + n, pose="standing" if n == 5 else "walking", gender="female", h=150, w=60)
        for n in range(12)
    ]
    world = World(tmp_path, crowd, tuple(range(0, 301, 5)))
    steps = []
    for errors in (PROFILES["realistic"], PROFILES["realistic"], PERFECT):
        play, made = Play(tmp_path, errors), []
        play.change(ReAct, world, [STANDING], t1=150, steps=made)
        play.servers[0].shutdown()
        play.servers[0].server_close()
        steps.append([(step.request, step.response) for step in made])
    assert steps[0] == steps[1] != steps[2]
