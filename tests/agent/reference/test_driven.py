"""The policy `driven`: what is asked of a picture, what is read from a reply, and games of the simulated model."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from painted import World, still
from reference_play import CHOICES, Scripted, text_of
from world_calls import PLAN as WORDY
from world_calls import look as observation

from jrdb_avr.agent.beliefs.world_model import WorldModel
from jrdb_avr.agent.methods.attempt import Attempt
from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.agent.model.messages import wire
from jrdb_avr.agent.model.reply import read_completion
from jrdb_avr.agent.perceive.geometry import DERIVED
from jrdb_avr.agent.perceive.readings import ReadLabel, ReadTie
from jrdb_avr.agent.reference.driven import DrivenEpisode
from jrdb_avr.agent.reference.method import ReferenceAgent
from jrdb_avr.agent.perceive.fields import (
    CANNOT_TELL,
    Perceiver,
    fields_of,
    perceivable,
    perceive_schema,
    read_people,
)
from jrdb_avr.agent.reference.recognize import recognize
from jrdb_avr.agent.simulated.knobs import Knobs
from jrdb_avr.agent.simulated.server import Server
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.errors import DecodeError, InputError
from jrdb_avr.schema.panorama import Box, iou
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import FIRST_LEFT, SAME_GROUP
from jrdb_avr.schema.wording.text import render

WOMAN = Plan(
    "a",
    "a",
    {"t0": Time(frame=150)},
    (Node("a", (Condition(attribute="gender", value="female"), Condition(action="reading", at="t0"))),),
    (),
    AnswerSpec("multiple_choice", "action", "a", "t0"),
)
FRAMES = tuple(range(0, 300, 5))
FIELDS = fields_of(WOMAN)
SEEN = observation(150)


def person(box=(100, 100, 300, 900), **said):
    """One of the people of a reply; what is not given cannot be told."""
    unknown = {field.key: CANNOT_TELL for field in FIELDS}
    return {"box": list(box), **unknown, **said}


def tied(fields, others, left=100):
    """One of the people of a reply with these fields, in a conversation with these others."""
    said = {field.key: None if field.kind in ("metres", "relation") else CANNOT_TELL for field in fields}
    return {"box": [left, 100, left + 200, 900], **said, "relation conversation": others}


def people(*listed):
    return read_people({"people": list(listed)}, FIELDS, SEEN, "o1", CONTRACT)


# -- what is asked ----------------------------------------------------------------------------------------------------


def test_the_offered_actions_are_read_if_the_plan_reads_an_action():
    offered = ("walking", "bending down", "talking to someone", "holding something")
    spec = AnswerSpec("multiple_choice", "action", "a", at="t0")
    plan = Plan("a", "a", WOMAN.times, (Node("a"),), (), spec)
    added = {field.key for field in fields_of(plan, offered)} - {field.key for field in fields_of(plan)}
    assert added == {"pose", "action talking to someone", "action holding sth"}
    other = Plan("a", "a", WOMAN.times, (Node("a"),), (), AnswerSpec("multiple_choice", "next_action", "a", at="t0"))
    assert fields_of(other, offered) == fields_of(other)


def test_statements_stand_among_as_many_others():
    stated = [field for field in fields_of(WORDY) if field.value]
    kinds = [field.name for field in stated]
    # Of a group its ties are read, in place of its size.
    assert sorted(kinds) == ["interaction"] * 2 + ["object"] * 2 + ["relation"] * 4
    assert {field.value for field in stated} >= {"hugging", "holding: bag", "conversation", SAME_GROUP}
    assert len({field.key for field in stated}) == len(stated)


def test_what_boxes_decide_is_not_asked():
    beside = Plan("a", "b", WOMAN.times, (WOMAN.nodes[0], Node("b")), (Edge("a", FIRST_LEFT, "b", "t0"),), WOMAN.answer)
    assert not any(field.value in DERIVED for field in fields_of(beside))


def test_a_schema_closes_every_field():
    entry = perceive_schema(FIELDS)["properties"]["people"]["items"]
    assert set(entry["required"]) == {"box", *(field.key for field in FIELDS)}
    assert "action reading" in entry["required"]


SHIRT = Plan(
    "a",
    "a",
    WOMAN.times,
    (Node("a", (Condition(attribute="shirt", value="red", at="t0"),)),),
    (),
    AnswerSpec("multiple_choice", "attribute", "a", "t0", attribute="shoes"),
)


def test_free_attributes_are_asked_for_without_the_value_that_is_wanted():
    fields = {field.key: field for field in fields_of(SHIRT)}
    assert [*fields] == ["gender", "age", "attribute shirt", "attribute shoes"]
    assert "red" not in str(fields["attribute shirt"].form())
    for read, keys in {"age": set(), "sector": set(), "distance": {"distance_m"}, "group_size": {"relation"}}.items():
        spec = AnswerSpec("multiple_choice", "attribute", "a", "t0", attribute=read)
        asked = {field.key.split(" ")[0] for field in fields_of(Plan("a", "a", SHIRT.times, (Node("a"),), (), spec))}
        assert asked == {"gender", "age", *keys}


def test_what_joins_a_person_to_a_thing_is_read_of_the_person():
    nodes = (Node("t", kind="table"), Node("a"), Node("b", kind="person"))
    edges = tuple(Edge(who, label, "t", "t0") for who, label in (("a", "sitting"), ("b", "Next to"), ("b", FRONT)))
    plan = perceivable(Plan("t", "b", WOMAN.times, nodes, edges, WOMAN.answer))
    assert (plan.root, plan.edges, [node.id for node in plan.nodes]) == ("b", (), ["a", "b"])
    assert plan.nodes[0].conditions == (Condition(object="table", verb="sitting", at="t0"),)
    assert plan.nodes[1].conditions == (Condition(attribute="next_to", value="table", at="t0"),)
    assert {"object sitting: table", "attribute next_to"} <= {field.key for field in fields_of(plan)}
    assert perceivable(WOMAN) == WOMAN


@pytest.mark.parametrize("label", ["sector", "Group size", "distance", "action", "relation", "pose"])
def test_words_to_a_thing_that_name_an_attribute_with_labels_are_left_out(label):
    nodes, edge = (Node("a"), Node("t", kind="table")), Edge("a", label, "t", "t0")
    plan = perceivable(Plan("a", "a", WOMAN.times, nodes, (edge,), WOMAN.answer))
    assert plan.nodes == (Node("a"),) and plan.edges == ()


THING = {"id": "t", "kind": "table"}


FRONT = "within 30 degrees to the left of (robot view)"


@pytest.mark.parametrize("said", ["", " ", 3, None, "x" * 41, "red\0"])
def test_free_words_are_short(said):
    fields = [field for field in fields_of(SHIRT) if field.kind == "words"]
    line = {"box": [100, 100, 300, 900], "attribute shirt": "Dark  Red", "attribute shoes": CANNOT_TELL}
    (one,) = read_people({"people": [line]}, fields, SEEN, "o1", CONTRACT)
    assert one.labels == (ReadLabel("shirt", "dark red"),)
    with pytest.raises(DecodeError, match="attribute shoes"):
        read_people({"people": [line | {"attribute shoes": said}]}, fields, SEEN, "o1", CONTRACT)


# -- what is read -----------------------------------------------------------------------------------------------------


def test_what_is_denied_is_read_and_what_cannot_be_told_is_not():
    (one,) = people(person(gender="female", **{"action reading": "no"}))
    assert set(one.labels) == {ReadLabel("gender", "female"), ReadLabel("action", "reading", holds=False)}
    assert one.box == pytest.approx(Box(SEEN.left + 48, 48, 96, 384)) and one.whole
    assert not people(person((0, 100, 300, 900)))[0].whole


def test_a_relation_is_denied_of_everybody_who_is_not_named():
    fields = [field for field in fields_of(WORDY) if field.value == "conversation"]
    listed = [{"box": [100, 100, 300, 900], "relation conversation": said} for said in ([2], [], None)]
    read = read_people({"people": listed}, fields, SEEN, "o1", CONTRACT)
    assert read[0].ties == (ReadTie("conversation", 2, True), ReadTie("conversation", 3, False))
    assert not any(tie.holds for tie in read[1].ties) and read[2].ties == ()


@pytest.mark.parametrize(
    "wrong",
    [
        {"people": 3},
        {"people": [person()] * 11},
        {"people": [person(gender="woman")]},
        {"people": [person(colour="red")]},
        {"people": [person((300, 100, 100, 900))]},
        {"people": [], "answer": 1},
    ],
)
def test_a_reply_outside_the_contract_is_refused(wrong):
    with pytest.raises(DecodeError):
        read_people(wrong, FIELDS, SEEN, "o1", CONTRACT)


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5) | st.floats(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["people", "box", "pose"]), inner),
    max_leaves=8,
)


@given(_JSON)
def test_any_json_is_read_or_refused(value):
    try:
        read = read_people({"people": value}, FIELDS, SEEN, "o1", CONTRACT)
    except DecodeError:
        return
    assert len(read) == len(value)


def test_a_malformed_reply_is_asked_again_once(tmp_path):
    chat = Scripted(["nothing", {"people": [person()]}])
    task = World(tmp_path, [], FRAMES).task("Who?", "multiple_choice", CHOICES)
    assert len(Perceiver(Attempt(task, chat, CONTRACT), FIELDS).people(SEEN, "o1")) == 1
    chat = Scripted(["nothing"])
    assert Perceiver(Attempt(task, chat, CONTRACT), FIELDS).people(SEEN, "o1") is None
    assert len(chat.requests) == 2 and "could not be used" in text_of(chat.requests[1])


def test_two_people_with_one_box_are_asked_for_again_and_left_out_if_they_stay(tmp_path):
    fields = fields_of(WORDY)
    lines = [{**tied(fields, [2, 3])}, {**tied(fields, []), "box": [100, 101, 300, 900]}, tied(fields, [], left=600)]
    task = World(tmp_path, [], FRAMES).task("Who?", "multiple_choice", CHOICES)
    chat = Scripted([{"people": lines}, {"people": lines[2:]}])
    assert len(Perceiver(Attempt(task, chat, CONTRACT), fields).people(SEEN, "o1")) == 1
    assert "1 and 2 have the same box" in text_of(chat.requests[1])
    chat = Scripted([{"people": lines}])
    (left,) = Perceiver(Attempt(task, chat, CONTRACT), fields).people(SEEN, "o1")
    assert (left.number, len(chat.requests)) == (3, 2) and not left.ties


@pytest.mark.parametrize("said, number", [(3, 3), (0, 0), (None, None), (2, None), (4, None)])
def test_somebody_is_known_again_only_among_the_people_who_are_left(tmp_path, said, number):
    first, _, third = people(*[person()] * 3)
    task = World(tmp_path, [], FRAMES).task("Who?", "multiple_choice", CHOICES)
    attempt = Attempt(task, Scripted([{"person": said}]), CONTRACT)
    assert recognize(attempt, first, SEEN, SEEN, (first, third)) == number


# -- games ------------------------------------------------------------------------------------------------------------


class Chat:
    """The simulated model without its socket."""

    def __init__(self, knobs):
        self.server = Server(knobs=knobs)
        self.requests = []

    def complete(self, messages, schema=None):
        self.requests.append(messages)
        body = json.dumps({"messages": wire(messages)}).encode()
        return read_completion(json.dumps(self.server.reply(body)).encode())


READER = still(1845, 7, gender="female", age="young adulthood", pose="sitting", actions=("reading",))
OTHERS = [
    still(300, 8, gender="female", age="young adulthood", pose="standing"),
    still(2900, 9, gender="male", age="young adulthood", pose="walking", actions=("reading",)),
]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return World(tmp_path_factory.mktemp("painted"), [READER, *OTHERS], FRAMES)


@pytest.fixture(scope="module")
def beliefs():
    with WorldGraph.memory() as graph:
        yield WorldModel(graph, "driven")


def game(world, beliefs=None):
    chat, writes = Chat(Knobs()), []
    task = world.task(render("change", CHANGE, "0" * 64), "multiple_choice", CHOICES, [], writes)
    return ReferenceAgent(chat, world=beliefs, policy="driven").answer(task), chat, writes


CHANGE = Plan(
    "a",
    "a",
    {"t0": Time(frame=150), "t1": Time(frame=250)},
    WOMAN.nodes,
    (),
    AnswerSpec("multiple_choice", "action", "a", "t1"),
)


def test_the_reader_is_found_and_the_choice_proven(world, beliefs):
    prediction, _, writes = game(world, beliefs)
    assert prediction.answer == Choice(3) and prediction.verdict == "certain"
    frame, box = prediction.evidence.frame, Box(*prediction.evidence.box)
    assert iou(box, READER.box(frame)) > 0.9
    assert prediction.n_observations <= 24
    tools = [write.tool for write in writes if write.accepted]
    assert {"plan", "observe", "add_entity", "add_attribute", "final_answer"} <= set(tools)
    assert all(write.accepted for write in writes)


def test_no_request_about_a_picture_holds_the_question(world):
    _, chat, _ = game(world)
    asked = [text_of(messages) for messages in chat.requests]
    assert "Question: " in asked[0] and not any("Question: " in text or "Choices" in text for text in asked[1:])


def test_without_a_world_model_there_is_no_verdict_and_nothing_is_written(world):
    alone, _, writes = game(world)
    assert (alone.answer, alone.verdict, writes) == (Choice(3), None, [])


def test_a_model_that_says_nothing_legible_ends_with_no_answer(world):
    attempt = Attempt(world.task("Who?", "multiple_choice", CHOICES), Scripted(["?"]), CONTRACT)
    prediction = DrivenEpisode(attempt, WOMAN, looks=4).play()
    assert (prediction.answer, prediction.n_observations) == (None, 4)
    assert len(set(attempt.made)) == 4


def test_a_sequence_without_legal_frames_ends_with_no_answer(world):
    task = world.task("Who?", "multiple_choice", CHOICES)
    blind = replace(task, sequence=replace(task.sequence, frames=()))
    prediction = ReferenceAgent(Scripted(["?"]), policy="driven").answer(blind)
    assert (prediction.answer, prediction.n_observations) == (None, 0)


def test_the_value_of_a_free_attribute_is_answered(world):
    line = {"box": [400, 100, 600, 900], "gender": "female", "age": CANNOT_TELL}
    line |= {"attribute shirt": "Red", "attribute shoes": "White"}
    task = world.task("Who?", "multiple_choice", ("Black", "White"))
    attempt = Attempt(task, Scripted([{"people": [line]}]), CONTRACT)
    assert DrivenEpisode(attempt, SHIRT, looks=3).play().answer == Choice(2)


def test_a_person_at_a_thing_at_a_moment_is_played_without_a_fault(world, beliefs):
    at = {"a": "t0", "b": "t1"}
    plan = {
        "root": "a",
        "target": "b",
        "times": {"t0": {"frame": 150}, "t1": {"before": "t0"}},
        "nodes": [{"id": "a", "conditions": [{"action": "reading", "at": "t0"}]}, {"id": "b"}, THING],
        "edges": [{"source": who, "relation": "next to", "target": "t", "at": time} for who, time in at.items()],
        "answer": {"mode": "multiple_choice", "read": "action", "of": "b", "at": "t0"},
    }
    chat = Chat(Knobs())
    first = Scripted([plan])
    both = SimpleNamespace(complete=lambda *asked: (chat if first.requests else first).complete(*asked))
    writes = []
    task = world.task("Who?", "multiple_choice", CHOICES, [], writes)
    prediction = ReferenceAgent(both, world=beliefs, policy="driven").answer(task)
    assert prediction.answer is not None and prediction.evidence is not None
    assert all(write.accepted for write in writes)


@pytest.mark.parametrize("policy", ["driven", "guided"])
def test_a_passive_agent_has_no_looks_to_choose(policy):
    with pytest.raises(InputError, match="passive"):
        ReferenceAgent(Scripted([]), looks=False, policy=policy)
