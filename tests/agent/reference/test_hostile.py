"""The reference agent against models that send anything: it ends within its limits, and a replay is the same."""

import json
import math

import pytest
from environment import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st
from reference_play import (
    ADVISED,
    GRAPH,
    MAN,
    PLAN,
    WOMAN,
    attribute,
    chat_final,
    entity,
    final,
    form_of,
    look,
    people,
    play,
    relation,
    turn,
    writes,
)

from jrdb_avr.agent.model.reply import Reply
from jrdb_avr.agent.reference.loop import Limits
from jrdb_avr.agent.reference.turns import MOST_CALLS, read_calls
from jrdb_avr.agent.world.episode import WorldModel
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.method import Prediction

SMALL = Limits(looks=2, turns=6, panoramas=2)
TOOLS = ("observe", "add_people", "add_entity", "add_attribute", "add_relation", "get_graph", "final_answer")
VARIANTS = [(looks, remembers) for looks in (True, False) for remembers in (True, False)]

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
NAMES = ("id", "people", "observation", "box", "entity", "name", "value", "source", "target", "answer")
calls = st.one_of(
    junk,
    st.sampled_from(
        [ADVISED, look(), look(155), GRAPH, people(), entity(), attribute("gender", "female"), relation(), final(),
         chat_final(), people({}), people({"id": "p1", "box": [1, 2, 30, 40]})]
    ),
    st.builds(
        lambda tool, arguments: {**arguments, "tool": tool},
        st.sampled_from(TOOLS),
        st.dictionaries(st.sampled_from([*NAMES, "frame_id", "angle_deg"]), junk, max_size=5),
    ),
)  # fmt: skip
said = st.one_of(
    st.text(max_size=40),
    st.lists(calls, max_size=6).map(lambda made: json.dumps({"calls": made})),
    junk.map(json.dumps),
    st.just(json.dumps(PLAN)),
)
replies = st.builds(
    lambda text, reason: Reply(text, finish_reason=reason), said, st.sampled_from(["stop"] * 6 + ["length", "", "x"])
)


def stopped(text):
    return Reply(text, finish_reason="stop")


@settings(max_examples=examples(40))
@given(st.sampled_from(VARIANTS), st.booleans(), st.lists(replies, min_size=1, max_size=7))
@example((True, True), True, [stopped('{"calls": [{"tool": "\\ud800"}]}')])
@example((True, False), True, [stopped('{"calls": [{"tool": "observe", "\\ud800": 1}]}')])
@example((True, True), True, [stopped('{"calls": [{"tool": "observe", "a": 1e999}]}')])
def test_any_replies_end_in_a_prediction(world, variant, planned, said):
    """No exception, no more turns and looks than the limits, and a transcript of JSON."""
    looks, remembers = variant
    script = ([json.dumps(PLAN)] if remembers and planned else []) + said
    game = play(script, world=world if remembers else None, looks=looks, limits=SMALL)
    prediction = game.prediction
    assert isinstance(prediction, Prediction)
    assert prediction.status in ("answered", "invalid")
    missing = prediction.answer is None or prediction.evidence is None
    assert prediction.status == "answered" or (missing and prediction.reason)
    assert (prediction.verdict is not None) == remembers
    assert prediction.answer is not None or not remembers
    assert prediction.n_model_calls == len(game.requests) <= SMALL.turns + (1 + SMALL.repairs) * remembers
    assert prediction.n_observations <= 2
    if prediction.evidence is not None:
        assert all(map(math.isfinite, prediction.evidence.box))
    for step in game.steps:
        json.loads(step.request.encode()), json.loads(step.response.encode())
    for request in game.requests:
        for message in request:
            for part in message.parts:
                assert not isinstance(part, str) or part.encode().strip()


def transcript(script):
    with WorldGraph.memory() as graph:
        game = play(script, world=WorldModel(graph, "run"), name="0" * 16)
    return game.prediction, [(step.kind, step.request, step.response) for step in game.steps], game.writes


def test_a_replay_gives_the_same_transcript():
    """A question depends on the task and the replies alone."""
    script = [
        {"root": "a"},
        PLAN,
        turn(ADVISED),
        writes(WOMAN, MAN, then=[attribute("pose", "running"), look(150, 180.2)]),
        "what?",
        turn(entity(box=(1, 2, 3, 4)), GRAPH, final()),
        writes(MAN, observation="o3", then=[ADVISED]),
        turn(final(4, "p2")),
        turn(final(4, "p2")),
    ]
    assert transcript(script) == transcript(script)


@given(junk)
def test_a_turn_is_read_or_malformed(value):
    try:
        made = read_calls(value, TOOLS)
    except DecodeError:
        return
    assert 1 <= len(made) <= MOST_CALLS
    for call in made:
        assert call.tool in (*TOOLS, "?")
        assert len(call.text) < 13_000 and call.text.isascii()


@given(st.lists(calls, min_size=1, max_size=5))
def test_a_list_of_any_calls_is_read(given):
    made = read_calls({"calls": given}, TOOLS)
    assert len(made) == len(given)
    for call, raw in zip(made, given, strict=True):
        known = isinstance(raw, dict) and raw.get("tool") in TOOLS
        assert known == (call.tool != "?")
        assert call.fault or {"tool": call.tool, **call.arguments} == raw or raw != raw


@pytest.mark.parametrize("key", ["gender", "pose", "relation conversation", "box", "id"])
@given(value=junk)
@example(value="0")  # Also the number of a slot.
@example(value="o1")  # Also the name of a look.
@settings(max_examples=examples(10))
def test_any_value_of_a_field_is_read_or_refused(world, key, value):
    def reply(text):
        one = {"id": "p1", "box": [100, 250, 250, 700], **form_of(text)} | {key: value}
        return turn(people(one))

    game = play([PLAN, turn(look()), reply, turn(final())], world=world, limits=SMALL)
    assert game.prediction.status == "answered"
