"""The plan stage: what a plan must keep to, and that every gold plan does."""

import json
import re
from types import SimpleNamespace

import pytest
from reference_play import PLAN, PLANS

from jrdb_avr.agent.look.ranking import parts_of
from jrdb_avr.agent.perceive.fields import perceivable
from jrdb_avr.agent.reference.planning import plan_form, plan_prompt, read_plan, vocabulary
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import AGES, DISTANCE_WORDS, GENDERS, INTERACTIONS, OTHER_ACTIONS, POSES, ROBOT_SECTORS
from jrdb_avr.schema.method import Question, SequenceInfo
from jrdb_avr.schema.plan import canonical, plan_json_schema
from jrdb_avr.schema.relations import QUESTION_RELATIONS as RELATIONS
from jrdb_avr.schema.things import OBJECTS, VERBS


def task(mode="multiple_choice"):
    question = Question("0" * 16, "s", "?", ("walking",), mode)
    return SimpleNamespace(question=question, sequence=SequenceInfo("s", 15.0, 300, tuple(range(300))))


def with_condition(**condition):
    return PLAN | {"nodes": [{"id": "a", "conditions": [condition]}]}


def with_edge(relation):
    nodes = [{"id": "a", "conditions": []}, {"id": "b", "conditions": []}]
    edge = {"source": "a", "relation": relation, "target": "b", "at": "t0"}
    return PLAN | {"nodes": nodes, "edges": [edge]}


def to_thing(relation, kind):
    plan = with_edge(relation)
    return plan | {"nodes": [plan["nodes"][0], plan["nodes"][1] | {"kind": kind}]}


@pytest.mark.parametrize("relation", ["next to", "sitting", "within 30 degrees to the left of (robot view)"])
def test_a_thing_is_taken(relation):
    plan = read_plan(json.dumps(to_thing(relation, "table")), task())
    assert plan.things == {"b": "table"}


REFUSED = [
    (PLANS["frame"], "answer.mode: the question asks for 'multiple_choice', not 'frame'"),
    (PLAN | {"times": {"t0": {"frame": 300}}}, "times.t0.frame: the last frame of the video is 299"),
    (
        with_condition(action="sit", at="t0"),
        "nodes[0].conditions[0].action: 'sit' is none of the labels; perhaps 'sitting'",
    ),
    (with_condition(attribute="gender", value="woman"), "nodes[0].conditions[0].value: 'woman' is none of the labels"),
    (with_condition(attribute="sector", value="front", at="t0"), "nodes[0].conditions[0].value: 'front' is none"),
    (with_condition(attribute="group_size", value=0, at="t0"), "nodes[0].conditions[0].value: is the number of people"),
    (
        with_condition(object="bags", verb="holding", at="t0"),
        "nodes[0].conditions[0].object: 'bags' is none of the labels",
    ),
    (with_condition(object="bag", verb="has", at="t0"), "nodes[0].conditions[0].verb: 'has' is none of the labels"),
    (with_condition(interaction="talking", at="t0"), "nodes[0].conditions[0].interaction: 'talking' is none"),
    (with_edge("left of"), "edges[0].relation: 'left of' is none of the labels"),
    (with_edge("front left, far"), "edges[0].relation: 'front left, far' is none of the labels; perhaps"),
    (
        with_edge("hugging")
        | {"edges": with_edge("hugging")["edges"] * 25}
        | {"nodes": [{"id": n, "conditions": [{"action": "sitting", "at": "t0"}] * 4} for n in "ab"]},
        "plan: the maximum is 32 conditions and edges, not 33",
    ),
    (with_edge("next to"), "edges[0].relation: 'next to' is none of the labels; use \"first to the left of"),
    (to_thing("next to", "tables"), "nodes[1].kind: 'tables' is none of the labels; perhaps 'table'"),
    (to_thing("next to", "pedestrian"), "nodes[1].kind: 'pedestrian' is none of the labels"),
    (to_thing("conversation", "table"), "edges[0].relation: 'conversation' joins two people; use a verb"),
    (PLAN | {"answer": PLAN["answer"] | {"of": "b"}}, "answer.of: unknown node 'b'"),
]


@pytest.mark.parametrize("plan, reason", REFUSED)
def test_plans_that_are_refused(plan, reason):
    with pytest.raises(PlanError) as error:
        read_plan(json.dumps(plan), task())
    assert str(error.value).startswith(reason)


def test_labels_of_events_and_counts():
    times = PLANS["frame"]["times"]
    plan = PLANS["frame"] | {"times": times | {"t1": times["t1"] | {"action": "strolling"}}}
    with pytest.raises(PlanError, match=r"times\.t1\.action: 'strolling' is none of the labels"):
        read_plan(json.dumps(plan), task("frame"))
    plan = PLANS["number"] | {"answer": PLANS["number"]["answer"] | {"relation": "first to the left of (robot view)"}}
    with pytest.raises(PlanError, match=r"answer\.relation: .* is none of the labels"):
        read_plan(json.dumps(plan), task("number"))


def test_the_answer_is_read_of_the_target():
    plan = with_edge("conversation") | {"target": "b"}
    with pytest.raises(PlanError, match=r"answer\.of: the answer is read of the target, 'b'"):
        read_plan(json.dumps(plan), task())


@pytest.mark.parametrize("mode", PLANS)
def test_plans_that_are_taken(mode):
    plan = read_plan(json.dumps(PLANS[mode]), task(mode))
    assert json.loads(canonical(plan)) == PLANS[mode]


@pytest.mark.parametrize(
    "text",
    ["", "null", "[]", '{"root": 1e999}', '{"times": {"t0": {"frame": ' + "9" * 400 + "}}}", '"\\ud800"', "{" * 9000],
)
def test_any_text_is_a_plan_or_refused(text):
    with pytest.raises(PlanError):
        read_plan(text, task())


def test_the_prompt_lists_the_labels():
    """An example stands for relations of a kind with many labels. Of the longest kinds, the question's are listed."""
    told = vocabulary("Who is talking to someone and holding a bag next to the table, who is then hugging someone?")
    lines = dict(line[2:].split(": ", 1) for line in told.splitlines())
    labels = {kind: {part.partition(" = ")[0] for part in text.rstrip(".").split(", ")} for kind, text in lines.items()}
    assert labels["gender"] == set(GENDERS)
    assert labels["age"] == set(AGES)
    assert labels["sector"] == set(ROBOT_SECTORS)
    assert labels["distance"] == set(DISTANCE_WORDS)
    assert labels["action, postures and movements"] == set(POSES)
    assert "talking to someone" in labels["action, others"] < set(OTHER_ACTIONS)
    assert "hugging" in labels["interaction"] < set(INTERACTIONS)
    assert "holding" in labels["verb"] < set(VERBS)
    assert {"bag", "table"} <= labels["object"] < set(OBJECTS)
    assert "- object: " not in vocabulary("?")
    # What a relation of two people's places may say is told in full, and no more.
    places = {relation.split(", ")[1] for relation in RELATIONS if relation.startswith("front left, ")}
    assert lines["relation"].rstrip(".").rpartition("a comma and one of ")[2].split(", ") == sorted(
        places, key=DISTANCE_WORDS.index
    )
    words = set(told.replace(",", " ").replace(";", " ").split())
    for relation in {*RELATIONS} - {*INTERACTIONS}:
        assert set(relation.replace(",", " ").split()) <= words


def test_the_form_is_the_schema_without_prose_and_nulls():
    form, full = plan_form(), plan_json_schema()
    assert "null" not in json.dumps(form) and "description" not in json.dumps(form)
    assert list(form["$defs"]) == list(full["$defs"])
    for name, kind in full["$defs"].items():
        shown = form["$defs"][name]
        assert {key: shown[key] for key in ("required", "additionalProperties")} == {
            key: kind[key] for key in ("required", "additionalProperties")
        }
        assert list(shown["properties"]) == list(kind["properties"])
        for key, value in kind["properties"].items():
            options = [option for option in value.get("anyOf", [value]) if option != {"type": "null"}]
            left = shown["properties"][key]
            for option, kept in zip(options, left.get("anyOf", [left]), strict=True):
                assert {k: v for k, v in option.items() if k in ("type", "enum", "pattern", "$ref")} == {
                    k: v for k, v in kept.items() if k in ("type", "enum", "pattern", "$ref")
                }


def test_the_prompt_says_which_reads_fit_the_mode():
    assert "distance_change" in plan_prompt(task())
    assert "seconds_between" in plan_prompt(task("number"))
    assert "seconds_between" not in plan_prompt(task("span"))


def test_every_gold_plan_is_taken(sample_benchmark):
    """What the questions mean, in all templates, is a plan that the agent may make."""
    sequences = {row["sequence"]: row for row in sample_benchmark.questions("sequences").to_pylist()}
    questions = {row["question_id"]: row for row in sample_benchmark.questions("questions").to_pylist()}
    templates = set()
    for row in sample_benchmark.questions("answers").to_pylist():
        question = questions[row["question_id"]]
        info = SimpleNamespace(frame_count=sequences[question["sequence"]]["frame_count"])
        asked = SimpleNamespace(question=SimpleNamespace(answer_mode=question["answer_mode"]), sequence=info)
        plan = read_plan(row["plan"], asked)
        assert canonical(plan) == row["plan"]
        assert parts_of(perceivable(plan)) or not plan.edges
        told = set(re.split(" = |, |: |[.]", vocabulary(question["question"])))
        for node in plan.nodes:
            for condition in node.conditions:
                labels = {condition.object, condition.verb, condition.action, condition.interaction}
                assert labels - {None} <= told
        templates.add(question["template"])
    assert len(templates) == 12
