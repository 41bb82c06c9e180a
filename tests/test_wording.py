"""The wording table against its own inverse, and against what a reader must be told."""

import json

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from jrdb_avr.schema import wording
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.plan import AnswerSpec, Condition, Node, Plan, Time, canonical, parse_plan
from jrdb_avr.schema.vocabulary import (
    ACTIONS,
    AGES,
    DISTANCE_WORDS,
    GENDERS,
    INTERACTIONS,
    OTHER_ACTIONS,
    POSES,
    ROBOT_SECTORS,
)
from jrdb_avr.schema.wording import TEMPLATES, describe, in_order, moment, parse, question_id, question_key, render

KEYS = st.text("0123456789abcdef", min_size=64, max_size=64)
FRAMES = st.integers(0, 600_000)


def attribute(name, values, timed=True):
    return st.sampled_from(values).map(lambda value: Condition(attribute=name, value=value, at="t0" if timed else None))


CONDITIONS = st.lists(
    st.one_of(
        attribute("gender", list(GENDERS), timed=False),
        attribute("age", list(AGES), timed=False),
        st.sampled_from(ACTIONS).map(lambda action: Condition(action=action, at="t0")),
        st.sampled_from(INTERACTIONS).map(lambda label: Condition(interaction=label, at="t0")),
        attribute("group_size", [1, 2, 3, 7, 12, 13, 28]),
        attribute("sector", list(ROBOT_SECTORS)),
        attribute("distance", list(DISTANCE_WORDS)),
    ),
    min_size=1,
    max_size=5,
    unique_by=lambda c: c.attribute or c.action or c.interaction,
).map(in_order)


def make_plan(template, conditions, frames, action="walking"):
    """A plan of each template, written out here a second time."""
    times = {f"t{i}": {"frame": frame} for i, frame in enumerate(frames)}
    start = {"event": "start", "of": "a", "action": action, "after": "t0"}
    answer, events = {
        "change": ({"mode": "multiple_choice", "read": "action", "of": "a", "at": "t1"}, {}),
        "presence": ({"mode": "multiple_choice", "read": "presence", "of": "a", "at": ["t1", "t2"]}, {}),
        "distance": ({"mode": "multiple_choice", "read": "distance_change", "of": "a", "at": ["t0", "t1"]}, {}),
        "start": ({"mode": "frame", "read": "start", "of": "a", "at": "t1"}, {"t1": start}),
        "span": (
            {"mode": "span", "read": "span", "of": "a", "at": ["t1", "t2"]},
            {"t1": start, "t2": {"event": "end", "of": "a", "action": action, "after": "t1"}},
        ),
    }[template]
    node = {"id": "a", "conditions": [json.loads(canonical_condition(c)) for c in conditions]}
    document = {"root": "a", "target": "a", "times": times | events, "nodes": [node], "edges": [], "answer": answer}
    return parse_plan(json.dumps(document))


def canonical_condition(condition):
    return msgspec.json.encode(condition)


STATED = {"change": 2, "presence": 3, "distance": 2, "start": 1, "span": 1}


@st.composite
def plans(draw):
    template = draw(st.sampled_from(sorted(STATED)))
    frames = draw(st.lists(FRAMES, min_size=STATED[template], max_size=STATED[template]))
    return template, make_plan(template, draw(CONDITIONS), frames, draw(st.sampled_from(ACTIONS)))


def test_this_table_holds_the_templates_of_its_two_families():
    assert {name: row.family for name, row in TEMPLATES.items()} == {
        "start": "action_boundary",
        "span": "action_boundary",
        "change": "unique_anchor",
        "presence": "unique_anchor",
        "distance": "unique_anchor",
    }
    assert all(len(set(row.paraphrases)) >= 3 for row in TEMPLATES.values())


def test_every_action_and_interaction_has_words_and_no_two_share_them():
    assert set(wording.ACTION_PHRASES) == set(ACTIONS)
    assert set(wording.INTERACTION_PHRASES) == set(INTERACTIONS)
    phrases = [*wording.ACTION_PHRASES.values(), *wording.INTERACTION_PHRASES.values()]
    assert len(set(phrases)) == len(phrases)
    # Lists of phrases are split at these.
    assert not any(" and " in phrase or ", " in phrase for phrase in phrases)


@given(plans(), KEYS, st.booleans())
def test_parse_is_the_inverse_of_render(case, key, about):
    template, plan = case
    text = render(template, plan, key, about)
    found, back = parse(text)
    assert found == template
    assert canonical(back) == canonical(plan)


@given(plans(), KEYS, st.booleans())
def test_every_stated_time_has_its_frame_and_its_second(case, key, about):
    template, plan = case
    text = render(template, plan, key, about)
    for time in plan.times.values():
        if time.frame is not None:
            assert f"{time.frame / 15:.1f} s (frame {time.frame})" in text
    assert text.count("(frame ") == len(wording.stated_frames(plan)) == STATED[template]


@given(plans(), KEYS)
def test_left_and_right_are_the_robots(case, key):
    text = render(*case, key)
    for word in ("left", "right"):
        assert text.count(f" {word}") == text.count(f"to the robot's {word}")


@given(plans(), KEYS)
def test_about_is_said_of_events_only(case, key):
    template, plan = case
    exact, rough = render(template, plan, key, False), render(template, plan, key, True)
    if template in ("start", "span"):
        assert exact != rough and "about " in rough.lower() and "about" not in exact.lower()
    else:
        assert exact == rough


@given(plans(), KEYS, st.data())
def test_an_altered_question_is_refused_or_says_something_else(case, key, data):
    template, plan = case
    text = render(template, plan, key)
    place = data.draw(st.integers(0, len(text) - 1))
    letter = data.draw(st.sampled_from("x9 ,.A\n"))
    altered = text[:place] + letter + text[place + 1 :]
    try:
        found, back = parse(altered)
    except PlanError:
        return
    assert altered == text or (found, canonical(back)) != (template, canonical(plan))


QUESTION = "Find the only person who is walking at {}. What is that person's posture or movement at 15.0 s (frame 225)?"


@given(st.text(max_size=300))
@example("")
@example("Find the only person who is walking at 10.0 s (frame 150).")
@example(QUESTION.format("10.1 s (frame 150)"))
@example(QUESTION.format("10.0 s (frame 1\u06650)"))
def test_another_text_is_refused(text):
    assert parse(QUESTION.format("10.0 s (frame 150)"))[0] == "change"
    with pytest.raises(PlanError):
        parse(text)


def test_every_paraphrase_is_used():
    plan = make_plan("change", [Condition(action="sitting", at="t0")], [150, 225])
    texts = {render("change", plan, f"{i:064x}") for i in range(30)}
    assert len(texts) == len(TEMPLATES["change"].paraphrases)


DESCRIPTIONS = {
    "the only person who is sitting and looking into something": [
        {"action": "sitting"},
        {"action": "looking into sth"},
    ],
    "the only person far from the robot who is sitting": [
        {"action": "sitting"},
        {"attribute": "distance", "value": "far"},
    ],
    "the only person to the robot's left and close to it who is in a group of three": [
        {"attribute": "group_size", "value": 3},
        {"attribute": "sector", "value": "left"},
        {"attribute": "distance", "value": "close"},
    ],
    "the only person behind the robot who is walking, holding something and in no group": [
        {"action": "walking"},
        {"action": "holding sth"},
        {"attribute": "group_size", "value": 1},
        {"attribute": "sector", "value": "behind"},
    ],
}


@pytest.mark.parametrize(("text", "conditions"), DESCRIPTIONS.items())
def test_descriptions_read_so(text, conditions):
    assert describe([Condition(**condition, at="t0") for condition in conditions]) == text


def test_a_question_reads_so():
    plan = make_plan("start", [Condition(action="sitting", at="t0")], [150], "looking at robot")
    assert render("start", plan, "0" * 64, about=True) == (
        "Find the only person who is sitting at 10.0 s (frame 150). "
        "At about which frame does that person start looking at the robot for the first time after that?"
    )
    assert moment(28) == "1.9 s (frame 28)"


def test_render_refuses_what_it_cannot_say():
    sitting, far = Condition(action="sitting", at="t0"), Condition(attribute="distance", value="far", at="t0")
    change = make_plan("change", [sitting, far], [150, 225])
    cases = {
        "no template": ("nothing", change),
        "states t0, t1, t2": ("presence", change),
        "one action": ("start", make_plan("change", [sitting], [150, 225])),
        "in_order": ("change", make_plan("change", [far, sitting], [150, 225])),
        "no words for the action": ("change", make_plan("change", [Condition(action="juggling", at="t0")], [0, 225])),
        "no words for the place": (
            "change",
            make_plan("change", [Condition(attribute="sector", value="above", at="t0")], [0, 225]),
        ),
        "no words for the object": (
            "change",
            make_plan("change", [Condition(object="bag", verb="carrying", at="t0")], [0, 225]),
        ),
        "no words for other": ("change", make_plan("change", [Condition(attribute="gender", value="other")], [0, 225])),
        "is no size": (
            "change",
            make_plan("change", [Condition(attribute="group_size", value=0, at="t0")], [0, 225]),
        ),
        "given twice": ("change", make_plan("change", [far, far], [0, 225])),
    }
    for message, (template, plan) in cases.items():
        if "one action" in message or "states" in message:
            with pytest.raises(PlanError):
                render(template, plan, "0" * 64)
            continue
        with pytest.raises(PlanError, match=message):
            render(template, plan, "0" * 64)


def test_a_plan_of_another_shape_is_refused():
    plan = Plan(
        root="b",
        target="b",
        times={"t0": Time(frame=0), "t1": Time(frame=60)},
        nodes=(Node(id="b", conditions=(Condition(action="sitting", at="t0"),)),),
        edges=(),
        answer=AnswerSpec(mode="multiple_choice", read="action", of="b", at="t1"),
    )
    with pytest.raises(PlanError, match="no plan of the template"):
        render("change", plan, "0" * 64)


def test_identities_change_with_every_part():
    plan = make_plan("change", [Condition(action="sitting", at="t0")], [150, 225])
    other = make_plan("change", [Condition(action="sitting", at="t0")], [150, 240])
    keys = {
        question_key("s", 1, plan),
        question_key("s", 2, plan),
        question_key("r", 1, plan),
        question_key("s", 1, other),
    }
    assert len(keys) == 4 and all(len(key) == 64 for key in keys)
    base = ("s", "f", "t", "q", ["a", "b"], "multiple_choice")
    ids = {question_id(*base)}
    for i, value in enumerate(("x", "x", "x", "x", ["b", "a"], "x")):
        ids.add(question_id(*base[:i], value, *base[i + 1 :]))
    assert len(ids) == 7 and all(len(value) == 16 for value in ids)


def test_stated_words_and_frames():
    plan = make_plan("start", [Condition(action="sitting", at="t0")], [150], "typing")
    assert wording.stated_actions(plan) == ("sitting", "typing")
    assert wording.stated_frames(plan) == (150,)
    assert set(POSES).isdisjoint(OTHER_ACTIONS)
