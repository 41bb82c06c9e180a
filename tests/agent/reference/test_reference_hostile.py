"""The reference agent against models that say anything: it ends within its budget, and says the same again."""

import dataclasses
import itertools
import json
import math
import time

import pytest
from environment import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st
from painted import SEQUENCE, World, still
from reference_play import (
    CHOICES,
    GRAPH,
    PLAN,
    Scripted,
    StubSolver,
    attribute,
    defined,
    entity,
    final,
    look,
    play,
    proposed,
    text_of,
    turn,
)
from scored_runs import opened

from jrdb_avr.agent.beliefs.world_model import WorldModel
from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.reference.episode import Limits
from jrdb_avr.agent.reference.method import ReferenceAgent
from jrdb_avr.agent.reference.tool_calls import MOST_PER_TURN, read_calls
from jrdb_avr.engine.run import answering
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.compiler.find import Find
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Prediction

SMALL = Limits(looks=2, calls=6, panoramas=2)
TOOLS = ("observe", "add_entity", "add_attribute", "add_relation", "get_graph", "final_answer")
VARIANTS = [(looks, remembers) for looks in (True, False) for remembers in (True, False)]


@pytest.fixture(scope="module")
def graph():
    with WorldGraph.memory() as graph:
        yield graph


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return World(tmp_path_factory.mktemp("painted"), [still(1845, 7, pose="standing")], tuple(range(0, 300, 5)))


numbers = st.one_of(st.integers(-(10**30), 10**30), st.floats(), st.sampled_from([1e999, -0.0, 10**400]))
words = st.one_of(
    st.text(max_size=20),
    st.sampled_from(
        ["o1", "o2", "p1", "a", "000150", "\ud800", "\x00", "'; MATCH (n) DETACH DELETE n //", "../../etc/passwd"]
    ),
)
junk = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, words),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(words, inner, max_size=4)),
    max_leaves=5,
)
NAMES = ("id", "kind", "node", "observation", "box", "entity", "name", "value", "source", "target", "answer")
calls = st.one_of(
    junk,
    st.sampled_from([look(), look(155), GRAPH, entity(), attribute("gender", "female"), final(), proposed()]),
    st.builds(
        lambda tool, arguments: {**arguments, "tool": tool},
        st.sampled_from(TOOLS),
        st.dictionaries(st.sampled_from([*NAMES, "frame_id", "angle_deg"]), junk, max_size=5),
    ),
)
said = st.one_of(
    st.text(max_size=40),
    st.lists(calls, max_size=6).map(lambda made: json.dumps({"calls": made})),
    junk.map(json.dumps),
    st.just(json.dumps(PLAN)),
)
replies = st.builds(
    lambda text, reason: Reply(text, finish_reason=reason), said, st.sampled_from(["stop"] * 6 + ["length", "", "x"])
)


@settings(max_examples=examples(40))
@given(
    st.sampled_from(VARIANTS),
    st.booleans(),
    st.lists(replies, min_size=1, max_size=7),
    st.sampled_from([StubSolver(), StubSolver(box=(150, (0.0, 0.0, 9.0, 9.0))), defined()]),
)
@example((True, True), True, [Reply('{"calls": [{"tool": "\\ud800"}]}', finish_reason="stop")], StubSolver())
@example(
    (True, False), True, [Reply('{"calls": [{"tool": "observe", "\\ud800": 1}]}', finish_reason="stop")], StubSolver()
)
@example(
    (True, True), True, [Reply('{"calls": [{"tool": "observe", "a": 1e999}]}', finish_reason="stop")], StubSolver()
)
def test_any_replies_end_in_a_prediction(world, graph, variant, planned, said, solver):
    """Whatever is said: no exception, no more calls than are stated, looks within the budget, a transcript of JSON."""
    looks, remembers = variant
    script = ([json.dumps(PLAN)] if remembers and planned else []) + said
    game = play(world, script, graph=graph if remembers else None, looks=looks, limits=SMALL, solver=solver)
    prediction = game.prediction
    assert isinstance(prediction, Prediction)
    assert prediction.status in ("answered", "invalid")
    missing = prediction.answer is None or prediction.evidence is None
    assert prediction.status == "answered" or (missing and prediction.reason)
    assert prediction.verdict is None or remembers
    assert prediction.n_model_calls == len(game.requests) <= SMALL.model_calls(remembers)
    assert prediction.n_observations <= 2
    if prediction.evidence is not None:
        assert all(map(math.isfinite, prediction.evidence.box))
    for step in game.steps:
        json.loads(step.request.encode()), json.loads(step.response.encode())
    assert sum(step.kind == "tool" for step in game.steps) <= SMALL.calls + 5
    for request in game.requests:
        for message in request:
            for part in message.parts:
                assert not isinstance(part, str) or part.encode().strip()


def proposals(replies, made):
    """The choices of all readable final answers in these replies, of which the last repeats."""
    said = [*replies, *[replies[-1]] * made][:made]
    turns = [json.loads(reply)["calls"] for reply in said if reply != "hm"]
    answers = [call["answer"] for calls in turns for call in calls if call["tool"] == "final_answer"]
    return [answer for answer in answers if type(answer) is int and 1 <= answer <= 4]


def turns_with(finals):
    """Turns of which some hold a final answer, anywhere in them; some are malformed."""
    others = [GRAPH, look(), look(151), entity(node="a"), entity("p2"), attribute("gender", "female")]
    many = st.lists(st.sampled_from(others), max_size=7)
    said = st.builds(lambda before, final, after: turn(*before, *final, *after), many, finals, many)
    return st.lists(st.one_of(st.sampled_from(["hm", '{"calls": []}']), said), min_size=1, max_size=8)


def some(final, whose):
    return st.lists(st.builds(final, st.sampled_from([1, 2, 3, 4, 0, "2", None]), whose), max_size=1)


@settings(max_examples=examples(40))
@given(st.booleans(), turns_with(some(final, st.sampled_from(["p1", "p2", "nobody", 7]))))
def test_an_answer_once_proposed_is_never_lost(world, graph, looks, said):
    """Nor does anybody who was written down go without an answer and a box."""
    game = play(world, [PLAN, *said], graph=graph, looks=looks, limits=SMALL, solver="real")
    told = proposals(said, len(game.requests) - 1)
    somebody = any(write.tool == "add_entity" and write.accepted for write in game.writes)
    assert (game.prediction.answer is not None) == bool(told or somebody)
    assert (game.prediction.verdict is not None) == bool(told or somebody)
    if told and game.prediction.verdict == "guess":
        assert game.prediction.answer == Choice(told[-1])
    assert (game.prediction.evidence is not None) == somebody


def play_again(world, graph, script):
    game = play(world, script, graph=graph)
    steps = [(step.kind, step.request, step.response) for step in game.steps]
    return game.prediction, steps, game.writes


def test_a_replay_gives_the_same_transcript(world, graph):
    """An episode follows from the task and the replies alone, whatever was played before it."""
    script = [
        {"root": "a"},
        PLAN,
        turn(look(), look(150, 270)),
        turn(entity(node="a"), attribute("gender", "female"), attribute("action", "running"), look(150, 180.2)),
        "what?",
        turn(entity(box=(1, 2, 3, 4)), GRAPH, final()),
        turn(entity("p2", "o2"), final()),
        "what?",
    ]
    first = play_again(world, graph, script)
    play_again(world, graph, [PLAN, turn(look(0, 0)), turn(entity("other")), "x"])
    assert play_again(world, graph, script) == first
    with WorldGraph.memory() as other:
        assert play_again(world, other, script) == first


@given(junk)
def test_a_turn_is_read_or_malformed(value):
    try:
        made = read_calls(value, TOOLS)
    except DecodeError:
        return
    assert 1 <= len(made) <= MOST_PER_TURN
    for call in made:
        assert call.tool in (*TOOLS, "?")
        assert len(call.text) < 4000 and call.text.isascii()


@given(st.lists(calls, min_size=1, max_size=5))
def test_a_list_of_any_calls_is_read(given):
    made = read_calls({"calls": given}, TOOLS)
    assert len(made) == len(given)
    for call, raw in zip(made, given, strict=True):
        known = isinstance(raw, dict) and raw.get("tool") in TOOLS
        assert known == (call.tool != "?")
        assert call.fault or {"tool": call.tool, **call.arguments} == raw or raw != raw


# -- plans that are much work -----------------------------------------------------------------------------------------

NODES = [f"n{letter}" for letter in "abcdefghijklmnop"]


def wide_plan(nodes, joined, conditions=()):
    """A plan of so many nodes, whose edges are (source, relation, target); the answer is read of the first."""
    return {
        "root": NODES[0],
        "target": NODES[0],
        "times": {"t0": {"frame": 150}},
        "nodes": [{"id": node, "conditions": [] if n else list(conditions)} for n, node in enumerate(NODES[:nodes])],
        "edges": [{"source": a, "relation": relation, "target": b, "at": "t0"} for a, relation, b in joined],
        "answer": {"mode": "multiple_choice", "read": "action", "of": NODES[0], "at": "t0"},
    }


def crowd(people, ties):
    """Calls that add people, and say who talks with whom."""
    added = [entity(f"p{n}", box=(10 + 20 * n, 250, 25 + 20 * n, 708)) for n in range(people)]
    tie = {"tool": "add_relation", "name": "conversation", "observation": "o1"}
    return [look(), *added, *({**tie, "source": f"p{a}", "target": f"p{b}"} for a, b in ties)]


def in_turns(calls):
    return [turn(*calls[start : start + MOST_PER_TURN]) for start in range(0, len(calls), MOST_PER_TURN)]


ROW = [(a, "conversation", b) for a, b in itertools.pairwise(NODES)]
BOTH_WAYS = [edge for a, b in itertools.pairwise(NODES) for edge in ((a, "conversation", b), (b, "hugging", a))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joined", "why"), [(ROW, "too many sets of people"), (BOTH_WAYS, "nobody in the graph fits")], ids=["row", "ways"]
)
def test_the_widest_plan_over_all_that_a_question_may_write_ends_soon(world, graph, joined, why):
    """Everybody talks with everybody, so that sets of people who nearly fit are without number."""
    everybody = crowd(12, itertools.combinations(range(12), 2))[:79]
    started = time.process_time()
    game = play(
        world,
        [wide_plan(16, joined), *in_turns(everybody), turn(final(1, "p0"))],
        graph=graph,
        solver="real",
    )
    assert time.process_time() - started < 10
    assert (game.prediction.status, game.prediction.answer) == ("answered", Choice(1))
    assert game.prediction.evidence is not None
    assert any(why in step.response for step in game.steps)


class Voices:
    """A model that plays each question by its own script."""

    def __init__(self, scripts):
        self.voices = {question: Scripted(script) for question, script in scripts.items()}

    def complete(self, messages, schema=None):
        (question,) = (name for name in self.voices if f"Question: {name}\n" in text_of(messages))
        return self.voices[question].complete(messages, schema)


def slow_find(plan):
    """In the place of a plan's statement, one that the engine would be at for hours."""
    people = ", ".join(f"(n{n}:Entity)" for n in range(9))
    sum_of = " + ".join(f"n{n}.number" for n in range(9))
    return Find(f"MATCH {people} WHERE {sum_of} < 0 RETURN n0.name AS who0", (plan.root,), {})


def test_a_solving_that_takes_too_long_is_an_error_of_its_question_alone(world, graph, tmp_path, monkeypatch):
    """The engine stops, the run goes on, and what was stopped is asked again."""
    plan = wide_plan(2, [(NODES[0], "conversation", NODES[1])], [{"attribute": "gender", "value": "female"}])
    calls = [*crowd(20, [(0, 1)]), attribute("gender", "female", "p0"), attribute("action", "standing", "p0")]
    calls.append(final(2, "p0"))
    questions = [
        dataclasses.replace(world.task(text, "multiple_choice", CHOICES).question, question_id=f"{n:016x}")
        for n, text in enumerate(("Who waits?", "Who is planless?"))
    ]
    place = tmp_path / "journal.jsonl"

    def run():
        chat = Voices({"Who waits?": [plan, *in_turns(calls)], "Who is planless?": ["no plan"]})
        agent = ReferenceAgent(chat, world=WorldModel(graph, "late"))
        with opened(place) as journal:
            answering.answer_all(agent, questions, {SEQUENCE: world.info}, world.observe, world.panorama, journal, 2)
            return [journal.finished[question.question_id].prediction for question in questions]

    with monkeypatch.context() as patch:
        patch.setattr("jrdb_avr.agent.beliefs.solver.TIMEOUT_S", 0.02)
        patch.setattr("jrdb_avr.queries.compiler.beliefs.find_believed", slow_find)
        late, planless = run()
    assert (late["status"], planless["status"]) == ("error", "invalid")
    assert late["reason"].startswith("stopped after 0.02 s: ") and "\n" not in late["reason"]
    answered, kept = run()
    assert (answered["status"], answered["answer"]) == ("answered", '{"choice":2}')
    assert kept == planless
