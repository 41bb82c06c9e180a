"""The marker model plays the reference agent on painted worlds: plan, world model and solver, through pixels."""

import json

import msgspec
import pytest
from painted import Actor, World, still

from jrdb_avr.agent.beliefs.world_model import WorldModel
from jrdb_avr.agent.model.messages import wire
from jrdb_avr.agent.model.reply import read_completion
from jrdb_avr.agent.reference.method import ReferenceAgent
from jrdb_avr.agent.simulated.knobs import parse
from jrdb_avr.agent.simulated.server import Server
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.schema.answer_modes import same_answer
from jrdb_avr.schema.answers import Choice, FrameViewpoint, Number
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.panorama import WIDTH, Box, iou
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, SAME_GROUP
from jrdb_avr.schema.wording.people import in_order
from jrdb_avr.schema.wording.text import render

FRAMES = tuple(range(0, 601, 5))
POSES = ("walking", "sitting", "standing", "lying down")
FEMALE = Condition(attribute="gender", value="female")
LEFT_90 = "within 90 degrees to the left of (robot view)"
LEFT_60 = "within 60 degrees to the left of (robot view)"


class Chat:
    """A marker server without its socket; keeps every request and its reply."""

    def __init__(self, knobs):
        self.server = Server(knobs=knobs)
        self.said = []

    def complete(self, messages, schema=None):
        body = msgspec.json.encode({"messages": wire(messages)})
        reply = msgspec.json.encode(self.server.reply(body))
        self.said.append((body, reply))
        return read_completion(reply)

    def turns(self):
        return [json.loads(json.loads(reply)["choices"][0]["message"]["content"]) for _, reply in self.said]


@pytest.fixture(scope="module")
def beliefs():
    with WorldGraph.memory() as graph:
        yield WorldModel(graph, "painted")


class Player:
    def __init__(self, folder, beliefs, knobs):
        self.folder, self.beliefs = folder, beliefs
        self.chat = Chat(knobs)
        self.steps, self.writes = [], []

    def world(self, actors, frames=FRAMES):
        return World(self.folder / "world", actors, frames)

    def ask(self, world, template, plan, choices=(), looks=True, remembers=True):
        question = render(template, plan, "0" * 64)
        method = ReferenceAgent(self.chat, world=self.beliefs if remembers else None, looks=looks)
        task = world.task(question, plan.answer.mode, choices, self.steps, self.writes)
        return method.answer(task)

    def calls(self):
        return [json.loads(step.request) for step in self.steps if step.kind == "tool"]


@pytest.fixture(params=["on", "off"])
def player(request, tmp_path, beliefs):
    """Plays with identities, and without: nothing on these pages needs them."""
    made = Player(tmp_path, beliefs, parse([f"ids={request.param}"]))
    yield made
    made.chat.server.server_close()


def plan(spec, times, conditions=(), edges=()):
    times = {name: Time(frame=t) if isinstance(t, int) else t for name, t in times.items()}
    ids = sorted({"a"} | {edge[2] for edge in edges})
    nodes = tuple(Node(id=i, conditions=in_order(conditions) if i == "a" else ()) for i in ids)
    return Plan(
        root="a",
        target=ids[-1],
        times=times,
        nodes=nodes,
        edges=tuple(Edge(source=s, relation=r, target=t, at="t0") for s, r, t in edges),
        answer=spec,
    )


def reads(mode, read, at, of="a", **more):
    return AnswerSpec(mode=mode, read=read, of=of, at=at, **more)


def event(kind, action=None, after="t0", of="a"):
    return Time(event=kind, of=of, action=action, after=after)


def pose(name):
    return Condition(action=name, at="t0")


def check(prediction, answer, box):
    assert prediction.status == "answered", prediction
    assert same_answer(prediction.answer, answer), prediction
    truth = box(prediction.evidence.frame)
    assert truth is not None
    assert iou(Box(*prediction.evidence.box), truth) > 0.9


def moving(x, per_frame=0.6, y=120, w=70, h=220):
    return lambda frame: Box(x + per_frame * frame, y, w, h)


def person(box, identity=7, gender="female", **by_frame):
    """`by_frame` holds what the mark says, as values or functions of the frame."""

    def mark(frame):
        told = {name: value(frame) if callable(value) else value for name, value in by_frame.items()}
        return Mark(identity, **{"gender": gender, "pose": "standing", "group": 0, "distance_dm": 50, **told})

    return Actor(box, mark)


def man(angle, identity, **mark):
    """Somebody else at a panorama angle."""
    return still(WIDTH * angle / 360 - 25, identity, w=50, h=180, **{"gender": "male", "pose": "walking", **mark})


CROWD = [man(40, 21), man(118, 22), man(290, 24)]


def turned(until, before="standing", after="sitting"):
    return lambda frame: before if frame < until else after


# -- each template ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("x", [-200, WIDTH - 130])
def test_change_also_at_the_seam(player, x):
    box = moving(x)
    world = player.world([person(box, pose=turned(90)), *CROWD])
    asked = plan(reads("multiple_choice", "action", "t1"), {"t0": 15, "t1": 150}, (FEMALE,))
    check(player.ask(world, "change", asked, POSES), Choice(2), box)


def test_seconds_between_two_starts(player):
    box = moving(2000)
    told = {
        "pose": lambda frame: "sitting" if frame >= 240 else "standing",
        "actions": lambda frame: ("reading",) if 100 <= frame <= 180 else (),
    }
    world = player.world([person(box, **told), *CROWD])
    times = {"t0": 15, "t1": event("start", "reading"), "t2": event("start", "sitting")}
    asked = plan(reads("number", "seconds_between", ("t1", "t2")), times, (FEMALE,))
    check(player.ask(world, "gap", asked), Number(140 / 15), box)


def test_count(player):
    box = moving(1700, 0.1)
    group = [man(angle, 30 + n, group=3, gender="male") for n, angle in enumerate((174, 181, 188, 195, 201))]
    late = Actor(lambda frame: group[0].box(frame) if frame > 100 else None, group[0].mark)
    world = player.world([person(box, group=3), late, *group[1:], man(330, 40, group=4), man(300, 41, group=4)])
    spec = reads("number", "count", ("t1", "t2"), relation=SAME_GROUP)
    asked = Plan(
        root="a",
        target="a",
        times={"t1": Time(frame=15), "t2": Time(frame=195)},
        nodes=(Node(id="a", conditions=(FEMALE,)),),
        edges=(),
        answer=spec,
    )
    prediction = player.ask(world, "gap", asked)
    check(prediction, Number(5), box)
    assert prediction.answer.value == 5


def test_consequence(player):
    box = moving(900)
    world = player.world([person(box, pose=turned(260, "standing", "lying")), *CROWD])
    asked = plan(reads("multiple_choice", "next_action", "t1"), {"t0": 15, "t1": event("end")}, (FEMALE,))
    check(player.ask(world, "consequence", asked, POSES), Choice(4), box)


A, B, C = man(180, 1, gender="female"), man(160, 2), man(200, 3)
FIRST = ("a", FIRST_LEFT, "b"), ("b", FIRST_LEFT, "c")


def test_three_hops(player):
    last = man(120, 5, pose="sitting")
    edges = (*FIRST, ("c", FIRST_LEFT, "d"))
    asked = plan(reads("multiple_choice", "action", "t0", "d"), {"t0": 15}, (FEMALE,), edges)
    prediction = player.ask(player.world([A, B, man(140, 4), last, C]), "three_hop", asked, POSES)
    check(prediction, Choice(2), last.box)


def test_fork_and_join(player):
    joined = man(142, 5, pose="lying")
    edges = (("a", FIRST_LEFT, "b"), ("a", FIRST_RIGHT, "c"), ("b", LEFT_90, "d"), ("c", LEFT_60, "d"))
    asked = plan(reads("multiple_choice", "action", "t0", "d"), {"t0": 15}, (FEMALE,), edges)
    prediction = player.ask(player.world([A, B, C, man(120, 4), joined, man(260, 6)]), "fork_join", asked, POSES)
    check(prediction, Choice(4), joined.box)


def test_an_action_is_searched_after_two_hops(player):
    box = moving(1300, 0.8)
    actors = [A, B, person(box, 3, "male", pose=turned(200, "walking", "sitting")), man(260, 6)]
    times = {"t0": 15, "t1": event("start", "sitting", of="c")}
    asked = plan(reads("frame_viewpoint", "start_view", "t1", "c"), times, (FEMALE,), FIRST)
    angle = (1300 + 160 + 35) * 360 / WIDTH
    check(player.ask(player.world(actors), "action_search", asked), FrameViewpoint(200, angle), box)


# -- what is not as it should be --------------------------------------------------------------------------------------


def change_of(player, actors, **more):
    asked = plan(reads("multiple_choice", "action", "t1"), {"t0": 15, "t1": 150}, (FEMALE,))
    return player.ask(player.world(actors), "change", asked, POSES, **more)


def test_who_cannot_be_read_is_not_invented(player):
    """The choice is a guess, sent twice: it is of nobody, so it has no box."""
    small = Actor(lambda frame: Box(1800, 200, 12, 40), lambda frame: Mark(7, gender="female", pose="standing"))
    prediction = change_of(player, [small, *CROWD])
    assert (prediction.status, prediction.verdict, prediction.evidence) == ("answered", "guess", None)
    assert prediction.n_observations <= 9
    assert [call["entity"] for call in player.calls() if call["tool"] == "final_answer"] == ["nobody"] * 2
    assert not [call for call in player.calls() if call["tool"].startswith("add_")]


def test_nothing_is_written_twice_and_nothing_refused(player):
    prediction = change_of(player, [person(moving(1800), pose=turned(90)), *CROWD])
    assert prediction.status == "answered"
    assert all(write.accepted for write in player.writes)
    calls = [json.dumps(call, sort_keys=True) for call in player.calls()]
    assert len(set(calls)) == len(calls)


@pytest.mark.parametrize("spoiled", [1, 3])
def test_a_reply_that_was_spoiled_once_is_said_again(player, spoiled):
    whole = player.chat.complete

    def complete(messages, schema=None):
        reply = whole(messages, schema)
        return msgspec.structs.replace(reply, content="{") if len(player.chat.said) == 1 + spoiled else reply

    player.chat.complete = complete
    box = moving(1800)
    check(change_of(player, [person(box, pose=turned(90)), *CROWD]), Choice(2), box)


# -- the variants -----------------------------------------------------------------------------------------------------


def test_the_chat_variant_plays_without_a_plan(player):
    box = moving(1800)
    prediction = change_of(player, [person(box, pose=turned(90)), *CROWD], remembers=False)
    check(prediction, Choice(2), box)
    assert {call["tool"] for call in player.calls()} == {"observe", "final_answer"}


@pytest.mark.parametrize("remembers", [True, False])
def test_panoramas_that_show_all_that_is_asked(player, remembers):
    frames = (0, 15, 60, 90, 120, 150, 180, 210)
    box = moving(1800)
    asked = plan(reads("multiple_choice", "action", "t1"), {"t0": 15, "t1": 150}, (FEMALE,))
    world = player.world([person(box, pose=turned(90)), *CROWD], frames)
    prediction = player.ask(world, "change", asked, POSES, looks=False, remembers=remembers)
    check(prediction, Choice(2), box)
    assert prediction.n_observations == 8
