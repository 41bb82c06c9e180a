"""The graph plan: what is refused, and by which field's name."""

import json
import subprocess
import sys
from typing import get_args

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jrdb_avr.schema import plan_hints
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.plan import (
    ATTRIBUTES,
    Condition,
    Event,
    Plan,
    Read,
    canonical,
    parse_plan,
    plan_json_schema,
    validate,
)
from jrdb_avr.schema.plan_hints import hint
from jrdb_avr.schema.relations import RELATIONS

# The example of the design, word for word.
EXAMPLE = {
    "root": "a",
    "target": "c",
    "times": {"t0": {"frame": 150}, "t1": {"event": "start", "of": "c", "action": "walking", "after": "t0"}},
    "nodes": [
        {"id": "a", "conditions": [{"attribute": "gender", "value": "female"}, {"action": "sitting", "at": "t0"}]},
        {"id": "b", "conditions": []},
        {"id": "c", "conditions": []},
    ],
    "edges": [
        {"source": "a", "relation": "conversation", "target": "b", "at": "t0"},
        {"source": "b", "relation": "first to the left of (robot view)", "target": "c", "at": "t0"},
    ],
    "answer": {"mode": "frame_viewpoint", "read": "start_view", "of": "c", "at": "t1"},
}


def changed(**changes):
    """The example with parts replaced: `edges__0__source="x"` sets edges[0].source; DROP removes it."""
    plan = json.loads(json.dumps(EXAMPLE))
    for path, value in changes.items():
        *way, last = (int(part) if part.isdigit() else part for part in path.split("__"))
        place = plan
        for part in way:
            place = place[part]
        if value is DROP:
            del place[last]
        elif isinstance(place, list) and last == len(place):
            place.append(value)
        else:
            place[last] = value
    return json.dumps(plan)


DROP = object()
HAIR = {"attribute": "hair", "value": "x", "at": "t0"}
TABLE = {
    "nodes__3": {"id": "t", "kind": "table", "conditions": []},
    "edges__2": {"source": "c", "relation": "next to", "target": "t", "at": "t0"},
}
NODDING = {"action": "nodding", "at": "t0"}
VALUE = {"mode": "multiple_choice", "read": "attribute", "of": "c", "at": "t0"}


def test_the_example_is_valid_and_comes_back():
    plan = parse_plan(json.dumps(EXAMPLE))
    assert parse_plan(canonical(plan)) == plan
    assert canonical(parse_plan(canonical(plan))) == canonical(plan)
    assert plan.answer.times == ("t1",)
    # Defaults and the order of keys do not change the text that is hashed.
    assert canonical(parse_plan(changed(nodes__1__conditions=DROP))) == canonical(plan)
    assert canonical(parse_plan(json.dumps(EXAMPLE, sort_keys=True, indent=3))) == canonical(plan)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"root": "z"}, "root"),
        ({"target": "z"}, "target"),
        ({"target": "A"}, "target"),
        ({"root": DROP}, "plan"),
        ({"more": 1}, "plan"),
        ({"nodes": []}, "nodes"),
        ({"times": {}}, "times"),
        ({"nodes__1__id": "a"}, "nodes[1].id"),
        ({"nodes__3": {"id": "d"}}, "nodes[3].id"),
        ({"edges__1": {"source": "c", "relation": "r", "target": "b", "at": "t0"}}, "target"),
        ({"edges__0__source": "z"}, "edges[0].source"),
        ({"edges__0__target": "z"}, "edges[0].target"),
        ({"edges__0__target": "a"}, "edges[0].target"),
        ({"edges__1__at": "t9"}, "edges[1].at"),
        ({"edges__0__relation": ""}, "edges[0].relation"),
        ({"edges__0__more": 1}, "edges[0]"),
        ({"nodes__0__conditions__0__value": DROP}, "nodes[0].conditions[0].value"),
        ({"nodes__0__conditions__0__value": 3}, "nodes[0].conditions[0].value"),
        ({"nodes__0__conditions__0__at": "t0"}, "nodes[0].conditions[0].at"),
        ({"nodes__0__conditions__1__at": DROP}, "nodes[0].conditions[1].at"),
        ({"nodes__0__conditions__1__at": "t9"}, "nodes[0].conditions[1].at"),
        ({"nodes__0__conditions__1__attribute": "age"}, "nodes[0].conditions[1]"),
        ({"nodes__0__conditions__1": {"at": "t0"}}, "nodes[0].conditions[1]"),
        ({"nodes__0__conditions__1": {"object": "bag", "at": "t0"}}, "nodes[0].conditions[1].verb"),
        ({"nodes__0__conditions__1": {"attribute": "hair", "value": "x"}}, "nodes[0].conditions[1].at"),
        ({"nodes__0__conditions__1": HAIR | {"attribute": "Hair"}}, "nodes[0].conditions[1].attribute"),
        ({"nodes__0__conditions__1": HAIR | {"value": 2}}, "nodes[0].conditions[1].value"),
        ({"nodes__0__conditions__1": HAIR | {"attribute": "pose"}}, "nodes[0].conditions[1].attribute"),
        ({"answer": VALUE}, "answer.attribute"),
        ({"answer": VALUE | {"attribute": "sex"}}, "answer.attribute"),
        ({"answer": VALUE | {"attribute": "age", "mode": "number"}}, "answer.mode"),
        ({"answer": VALUE | {"attribute": "age", "at": ["t0", "t1"]}}, "answer.at"),
        ({"answer": VALUE | {"read": "action", "attribute": "age"}}, "answer.attribute"),
        *(
            (
                {"nodes__0__conditions__1": {"attribute": "group_size", "value": size, "at": "t0"}},
                "nodes[0].conditions[1].value",
            )
            for size in ("3", -1, 2**63)
        ),
        ({"nodes__2__kind": "table"}, "target"),
        ({"nodes__0__kind": "table"}, "nodes[0].conditions[0]"),
        ({"nodes__1__kind": "table"}, "edges[1].source"),
        ({"nodes__3": {"id": "t", "kind": "table"}}, "nodes[3].id"),
        ({**TABLE, "nodes__3": {"id": "t", "kind": "table", "conditions": [HAIR, NODDING]}}, "nodes[3].conditions[1]"),
        ({**TABLE, "answer__of": "t"}, "answer.of"),
        ({**TABLE, "times__t1__of": "t"}, "times.t1.of"),
        ({"times__t0": {}}, "times.t0"),
        ({"times__t2": {"before": "t1"}}, "times.t2.before"),
        ({"times__t2": {"after": "t9"}}, "times.t2.after"),
        ({"times__t2": {"before": "t0", "of": "a"}}, "times.t2.of"),
        ({"times__t0__before": "t0"}, "times.t0.before"),
        ({"times__t1__before": "t0"}, "times.t1.before"),
        ({"times__t2": {"before": "t0"}, "times__t1__after": "t2"}, "times.t1.after"),
        ({"times__t2": {"before": "t0"}, "answer": VALUE | {"attribute": "age", "at": "t2"}}, "answer.at"),
        ({"times__t0__event": "start"}, "times.t0"),
        ({"times__t0__of": "a"}, "times.t0.of"),
        ({"times__t0__frame": -1}, "times.t0.frame"),
        ({"times__t0__frame": 1.5}, "times.t0.frame"),
        ({"times": {"t0": {"frame": 1}, "T1": {"frame": 2}}}, "times.T1"),
        ({"times": {"t0": 3}}, "times.t0"),
        ({"times__t1__of": "z"}, "times.t1.of"),
        ({"times__t1__of": DROP}, "times.t1"),
        ({"times__t1__after": "t9"}, "times.t1.after"),
        ({"times__t1__after": "t1"}, "times.t1.after"),
        ({"times__t1__action": DROP}, "times.t1.action"),
        ({"times__t1__event": "leaves"}, "times.t1.action"),
        ({"times__t1__event": "joins_group"}, "times.t1.action"),
        ({"times__t2": {"event": "leaves_group", "of": "a", "after": "t1"}}, "times.t2.after"),
        ({"times__t2": {"before": "t1"}}, "times.t2.before"),
        ({"times__t1__event": "begins"}, "times.t1.event"),
        ({"answer__of": "z"}, "answer.of"),
        ({"answer__at": "t9"}, "answer.at"),
        ({"answer__at": ["t0", "t1"]}, "answer.at"),
        ({"answer__at": "t0"}, "answer.at"),
        ({"answer__mode": "number"}, "answer.mode"),
        ({"answer__mode": "guess"}, "answer.mode"),
        ({"answer__read": "span"}, "answer.mode"),
        ({"answer__relation": "conversation"}, "answer.relation"),
        ({"answer": {"mode": "number", "read": "count", "of": "c", "at": ["t0", "t1"]}}, "answer.relation"),
        ({"answer__of": "b"}, "times.t1.of"),
        ({"times__t1__event": "end"}, "answer.at"),
    ],
)
def test_a_fault_is_refused_by_its_field(changes, field):
    with pytest.raises(PlanError) as error:
        parse_plan(changed(**changes))
    assert error.value.field == field
    assert str(error.value).startswith(f"{field}: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "instead"),
    [
        ({"nodes__0__conditions__1": {"attribute": "posture", "value": "sitting", "at": "t0"}}, '{"action": '),
        ({"nodes__0__conditions__1": {"attribute": "holding", "value": "bag", "at": "t0"}}, '{"object": "bag", "verb"'),
        ({"nodes__0__conditions__1": {"color": "red", "at": "t0"}}, '{"attribute": "shirt", "value": "red"'),
        ({"nodes__0__conditions__1": {"action": "sitting", "time": "t0"}}, '"at"'),
        ({"nodes__0__conditions__1": {"action": "sitting", "at": "t0", "not": True}}, "denies nothing"),
        ({"answer": VALUE | {"read": "age"}}, '"attribute"'),
        ({"answer": VALUE | {"read": "duration"}}, '"seconds_between"'),
        ({"answer": VALUE | {"attribute": "side"}}, '"sector"'),
        ({"times__t1__event": "enters"}, '"returns"'),
        ({"times__t1__event": "joins"}, '"joins_group"'),
        ({"nodes__1__category": "table"}, '"kind"'),
    ],
)
def test_a_common_wrong_word_is_told_what_to_use(changes, instead):
    with pytest.raises(PlanError, match="; use ") as error:
        parse_plan(changed(**changes))
    assert instead in str(error.value).partition("; use ")[2] and "\n" not in str(error.value)


def test_what_is_used_instead_is_no_wrong_word_itself():
    """Nor is a word that a plan has."""
    known = {"attribute": ATTRIBUTES, "relation": RELATIONS, "read": get_args(Read), "event": get_args(Event)}
    known["key"] = Condition.__struct_fields__
    for place, words in plan_hints._INSTEAD.items():
        assert not {*words} & {*known[place]}
        for word in words:
            assert hint(place, word.upper()) == f"; use {words[word]}"
    assert hint("attribute", "shirt") == "" and hint("relation", "hugging") == ""


def test_things_lead_on_to_people_and_keep_their_kind():
    further = {"nodes__4": {"id": "d", "kind": "person"}}
    further["edges__3"] = {"source": "d", "relation": "next to", "target": "t", "at": "t0"}
    plan = parse_plan(changed(**TABLE, **further))
    assert plan.things == {"t": "table"} and '"kind":"table"' in canonical(plan)
    assert parse_plan(canonical(plan)) == plan
    assert '"kind"' not in canonical(parse_plan(json.dumps(EXAMPLE)))


def test_a_free_attribute_is_compared_in_lower_case():
    plan = parse_plan(changed(nodes__0__conditions__1={"attribute": "shirt", "value": "Dark  Red", "at": "t0"}))
    condition = plan.nodes[0].conditions[1]
    assert (condition.kind, condition.wanted) == ("free", ("shirt", "dark red"))


def one_person(answer, **times):
    """A plan about the person a alone, who is sitting at the first time."""
    conditions = [{"action": "sitting", "at": min(times)}]
    nodes = [{"id": "a", "conditions": conditions}]
    document = {"root": "a", "target": "a", "times": times, "nodes": nodes, "edges": [], "answer": answer}
    return json.dumps(document)


END = {"event": "end", "of": "a", "after": "t0"}
NEXT = {"mode": "multiple_choice", "read": "next_action", "of": "a", "at": "t1"}


def test_the_pose_that_ends_before_the_next_one_is_not_named():
    plan = parse_plan(one_person(NEXT, t0={"frame": 150}, t1=END))
    assert plan.times["t1"].action is None and plan.answer.times == ("t1",)
    assert parse_plan(one_person(NEXT, t0={"frame": 150}, t1=END | {"action": "sitting"})).answer.times == ("t1",)


SPAN = {"mode": "span", "read": "span", "of": "a", "at": ["t1", "t2"]}
SECONDS = {"mode": "number", "read": "seconds_between", "of": "a", "at": ["t1", "t2"]}
COUNT = {"mode": "number", "read": "count", "of": "a", "at": ["t1", "t2"], "relation": "in the same group as"}
START = {"event": "start", "of": "a", "action": "walking", "after": "t0"}


@pytest.mark.parametrize(
    ("answer", "times", "field"),
    [
        # An end that names no action, asked by another read, or not itself the time of the read.
        ({"mode": "multiple_choice", "read": "action", "of": "a", "at": "t1"}, {"t1": END}, "times.t1.action"),
        (SPAN, {"t1": START, "t2": END | {"after": "t1"}}, "times.t2.action"),
        (NEXT, {"t1": END, "t2": END | {"after": "t1"}}, "times.t2.action"),
        (NEXT, {"t1": {"event": "start", "of": "a", "after": "t0"}}, "times.t1.action"),
        (NEXT, {"t1": START}, "answer.at"),
        (NEXT, {"t1": {"frame": 300}}, "answer.at"),
        (NEXT | {"mode": "number"}, {"t1": END}, "answer.mode"),
        (SECONDS, {"t1": {"frame": 300}, "t2": START}, "answer.at"),
        (SECONDS, {"t1": START, "t2": {"event": "leaves", "of": "a", "after": "t0"}}, "answer.at"),
        (SECONDS | {"at": ["t1", "t1"]}, {"t1": START}, "answer.at"),
        (SECONDS | {"relation": "conversation"}, {"t1": START, "t2": START}, "answer.relation"),
        (COUNT, {"t1": START, "t2": {"frame": 300}}, "answer.at"),
        (COUNT, {"t1": {"frame": 300}, "t2": {"frame": 300}}, "answer.at"),
        (COUNT, {"t1": {"frame": 300}, "t2": {"frame": 150}}, "answer.at"),
        (COUNT | {"at": "t1"}, {"t1": {"frame": 300}}, "answer.at"),
    ],
)
def test_reads_and_the_times_they_are_asked_at(answer, times, field):
    with pytest.raises(PlanError) as error:
        parse_plan(one_person(answer, t0={"frame": 150}, **times))
    assert error.value.field == field


def test_seconds_and_counts():
    later = START | {"action": "typing"}
    assert parse_plan(one_person(SECONDS, t0={"frame": 0}, t1=START, t2=later)).answer.times == ("t1", "t2")
    # The time of a count's description is the first that it counts over.
    assert parse_plan(one_person(COUNT, t1={"frame": 0}, t2={"frame": 300})).answer.times == ("t1", "t2")


def test_events_that_wait_for_each_other_are_refused():
    times = {
        "t0": {"frame": 0},
        "t1": {"event": "leaves", "of": "c", "after": "t2"},
        "t2": {"event": "returns", "of": "c", "after": "t1"},
    }
    answer = {"mode": "number", "read": "seconds_between", "of": "c", "at": ["t1", "t2"]}
    with pytest.raises(PlanError, match="circle"):
        parse_plan(changed(times=times, answer=answer))
    times["t1"]["after"] = "t0"
    assert parse_plan(changed(times=times, answer=answer)).answer.times == ("t1", "t2")


WRONG_TIME = '{"root": "a", "target": "a", "times": {"t0": 5}'


@pytest.mark.parametrize(
    "text",
    [
        *("", "nonsense", "[]", "null", "{}", "1", "\ud800", "[" * 100_000, b"\xff", '{"root": 1}'),
        "\xee".encode("latin-1") + json.dumps(EXAMPLE).encode(),
        # A wrong time, and what is no JSON behind it.
        WRONG_TIME + ', "nodes": [',
        WRONG_TIME + "\ud800",
        WRONG_TIME + ', "times": 5}',
        WRONG_TIME + ', "nodes": ' + "[" * 5000,
        json.dumps(EXAMPLE | {"a\nb": 1}),
    ],
)
def test_what_is_no_plan_or_breaks_off_is_refused_in_one_line(text):
    with pytest.raises(PlanError) as refused:
        parse_plan(text)
    assert refused.value.field and "\n" not in str(refused.value)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=4) | st.sampled_from(["a", "t0", "start", "frame"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["id", "at", "frame", "t0", "read", "x"]), inner, max_size=3)
    ),
    max_leaves=6,
)


@given(st.sampled_from(sorted(EXAMPLE)), json_values)
def test_any_part_replaced_is_valid_or_refused(part, value):
    try:
        plan = parse_plan(changed(**{part: value}))
    except PlanError as error:
        assert error.field
        assert "\n" not in str(error)
    else:
        validate(plan)
        assert msgspec.json.decode(canonical(plan), type=Plan) == plan


def test_the_json_schema_names_every_part():
    text = json.dumps(plan_json_schema())
    for word in (*EXAMPLE, "conditions", "relation", "start_view", "leaves", "group_size"):
        assert f'"{word}"' in text


@pytest.mark.parametrize("part", ["conditions", "times"])
def test_a_plan_is_of_a_size_that_the_engine_plans_in_seconds(part):
    condition = '{"action": "walking", "at": "t0"}'
    conditions = ", ".join([condition] * (9 if part == "conditions" else 8))
    times = ", ".join(f'"t{n}": {{"frame": {n}}}' for n in range(17 if part == "times" else 16))
    text = (
        f'{{"root": "a", "target": "a", "times": {{{times}}}, "nodes": [{{"id": "a", "conditions": [{conditions}]}}], '
        '"edges": [], "answer": {"mode": "multiple_choice", "read": "action", "of": "a", "at": "t0"}}'
    )
    with pytest.raises(PlanError, match="length <="):
        parse_plan(text)


RACE = """
import sys, threading
from jrdb_avr.schema.plan import parse_plan
sys.setswitchinterval(1e-6)
start = threading.Barrier(32)
def work():
    start.wait()
    parse_plan(sys.argv[1])
threads = [threading.Thread(target=work) for _ in range(32)]
for thread in threads: thread.start()
for thread in threads: thread.join()
"""


@pytest.mark.slow
def test_many_threads_may_read_their_first_plan_at_once():
    """A decoder that is made while threads decode crashed the process three times in four."""
    text = (
        '{"root":"a","target":"a","times":{"t0":{"frame":1}},"nodes":[{"id":"a","conditions":[{"action":"sitting",'
        '"at":"t0"}]}],"edges":[],"answer":{"mode":"multiple_choice","read":"action","of":"a","at":"t0"}}'
    )
    for _ in range(4):
        assert subprocess.run([sys.executable, "-c", RACE, text], timeout=300).returncode == 0
