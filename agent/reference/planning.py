"""The plan stage: what a model is sent, and what its plan must keep to before anything is looked at."""

from __future__ import annotations

import difflib
import json
import time
from collections.abc import Callable, Collection
from functools import cache
from typing import TYPE_CHECKING, Any, Final

from jrdb_avr.agent.beliefs.arguments import printable
from jrdb_avr.agent.methods.attempt import Attempt
from jrdb_avr.agent.methods.requests import heading
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Message
from jrdb_avr.agent.model.prompts import frame_ranges, render
from jrdb_avr.agent.reference.tool_calls import compact_json
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.errors import DecodeError, PlanError
from jrdb_avr.schema.labels import (
    ACTION_PHRASES,
    ACTIONS,
    AGES,
    DISTANCE_WORDS,
    GENDERS,
    INTERACTION_PHRASES,
    INTERACTIONS,
    OTHER_ACTIONS,
    PERSON_SECTORS,
    POSES,
    ROBOT_SECTORS,
)
from jrdb_avr.schema.method import Task
from jrdb_avr.schema.plan import (
    READS,
    AnswerSpec,
    Condition,
    Node,
    Plan,
    Time,
    canonical,
    parse_plan,
    plan_json_schema,
)
from jrdb_avr.schema.plan_hints import hint
from jrdb_avr.schema.relations import (
    FIRST_LEFT,
    FIRST_RIGHT,
    QUESTION_RELATIONS,
    RELATIONS,
    RELATIONS_OF,
    SAME_GROUP,
    WINDOW_DEGREES,
    person_frame_label,
)
from jrdb_avr.schema.things import OBJECT_PHRASES, OBJECTS, PERSON_CATEGORIES, VERB_PHRASES, VERBS
from jrdb_avr.schema.wording.phrases import FAR_AWAY

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.world_model import BeliefEpisode

LONGEST_SENT: Final = 4000
"""Characters of a refused plan that are sent again."""

MOST_PARTS: Final = 32
"""Conditions and edges of a plan: a question's has a dozen, and the engine's work grows with them."""


def make_plan(
    attempt: Attempt, repairs: int, check: Callable[[Plan], object], episode: BeliefEpisode | None = None
) -> Plan:
    """The model's plan for the question, or the smallest one where all of `1 + repairs` tries are refused.

    Each try is one model call, with the plan before it and what was wrong with that one. `check` raises
    PlanError for a plan that the solver cannot run. The episode of a world model keeps every try.
    """
    task = attempt.task
    system, schema = plan_prompt(task), plan_form()
    refusal, text = "", ""
    for _ in range(1 + repairs):
        user = render(
            "agent_plan_task",
            heading=heading(task.question),
            frames=frame_ranges(task.sequence.frames),
            refusal=f"Your last plan: {text}\nYour plan was refused: {refusal}" if refusal else "",
        )
        reply = attempt.ask([Message("system", (system,)), Message("user", (user,))], schema)
        step, started = attempt.steps - 1, time.perf_counter()
        value: dict[str, Any] = {}
        text = printable(attempt.raw)
        try:
            value = decode.reply_object(reply, attempt.convention)
            text = compact_json(value)
            plan = read_plan(text, task)
            check(plan)
        except (DecodeError, PlanError) as error:
            refusal = printable(str(error))
            if episode is not None:
                episode.refused("plan", value if len(text) <= LONGEST_SENT else {}, refusal, step)
            attempt.record("tool", {"tool": "plan"}, {"refused": refusal}, started)
            text = text[:LONGEST_SENT]
        else:
            if episode is not None:
                episode.plan(plan, step)
            attempt.record("tool", {"tool": "plan"}, {"accepted": canonical(plan)}, started)
            return plan
    plan = smallest_plan(task)
    if episode is not None:
        episode.plan(plan, step)
    attempt.record("tool", {"tool": "plan"}, {"in place of a plan": canonical(plan)}, time.perf_counter())
    return plan


def smallest_plan(task: Task) -> Plan:
    """A plan of the target alone, of whom nothing is said, with the read that the answer's mode implies."""
    mode, frames = task.question.answer_mode, task.sequence.frames or (0,)
    read = MODES[mode].smallest_read
    times = {"t0": Time(frame=frames[0])}
    at: list[str] = []
    # Which action is meant is not known, nor which people are counted: the commonest stand for them.
    for events in READS[read].times:
        if events:
            time = Time(event=events[0], of="a", action="walking", after=f"t{len(times) - 1}")
        else:
            time = Time(frame=frames[-1 if at else 0])
        at.append(f"t{len(times)}" if events or at else "t0")
        times[at[-1]] = time
    names = at[0] if len(at) == 1 else tuple(at)
    answer = AnswerSpec(mode, read, "a", names, "conversation" if read == "count" else None)
    return Plan("a", "a", times, (Node("a", ()),), (), answer)


def read_plan(text: str, task: Task) -> Plan:
    """The plan of a JSON text, fit for the question. Raises PlanError naming the field.

    Beyond `schema.plan.validate`: its mode is the question's, its labels are known, its frames lie in the sequence.
    """
    plan = parse_plan(text)
    mode, frame_count = task.question.answer_mode, task.sequence.frame_count
    if plan.answer.mode != mode:
        raise PlanError("answer.mode", f"the question asks for {mode!r}, not {plan.answer.mode!r}")
    for name, moment in plan.times.items():
        if moment.frame is not None and moment.frame >= frame_count:
            raise PlanError(f"times.{name}.frame", f"the last frame of the video is {frame_count - 1}")
    if plan.answer.of != plan.target:
        raise PlanError("answer.of", f"the answer is read of the target, {plan.target!r}")
    count = sum(len(node.conditions) for node in plan.nodes) + len(plan.edges)
    if count > MOST_PARTS:
        raise PlanError("plan", f"at most {MOST_PARTS} conditions and edges are taken, not {count}")
    check_labels(plan)
    return plan


def plan_prompt(task: Task) -> str:
    """The system message of the plan stage."""
    mode = task.question.answer_mode
    return render(
        "agent_plan",
        fps=f"{task.sequence.fps:g}",
        mode=mode,
        reads=render(f"agent_reads_{mode}"),
        vocabulary=vocabulary(),
        schema=json.dumps(plan_form(), separators=(",", ":")),
    )


@cache
def plan_form() -> dict[str, Any]:
    """The plan's JSON Schema, without prose, and with keys left out where the full one allows null."""
    form: dict[str, Any] = _plain(plan_json_schema())
    return form


def _plain(node: Any) -> Any:
    if isinstance(node, list):
        return [_plain(entry) for entry in node]
    if not isinstance(node, dict):
        return node
    plain = {key: _plain(value) for key, value in node.items() if key not in _LEFT_OUT}
    either = plain.pop("anyOf", None)
    if either is not None:
        named = [option for option in either if option != {"type": "null"}]
        plain |= {"anyOf": named} if len(named) > 1 else named[0]
    return plain


_LEFT_OUT: Final = frozenset({"title", "description", "default", "propertyNames", "minLength", "maxLength"})


# -- labels -----------------------------------------------------------------------------------------------------------

THINGS: Final = tuple(category for category in OBJECTS if category not in PERSON_CATEGORIES)
"""The kinds of nodes that are no people."""

_LABELS: Final = {"action": ACTIONS, "interaction": INTERACTIONS, "object": OBJECTS, "verb": VERBS}
"""The labels of a condition's fields."""

_VALUES: Final = {"gender": GENDERS, "age": AGES, "sector": tuple(ROBOT_SECTORS), "distance": DISTANCE_WORDS}
"""The values of the attributes that have labels."""

_AGE_WORDS: Final = {
    "childhood": "child",
    "adolescence": "teenager",
    "young adulthood": "young",
    "middle adulthood": "middle-aged",
    "late adulthood": "elderly",
}


@cache
def vocabulary() -> str:
    """Every label, a line per kind, each with the words of a question where they differ: `bending = bending down`."""
    lines = {
        "gender": _listed(GENDERS),
        "age": _listed(AGES, _AGE_WORDS.__getitem__),
        "sector": _listed(ROBOT_SECTORS),
        "distance": _listed(DISTANCE_WORDS, lambda word: FAR_AWAY[word].rpartition("(")[2].rstrip(")")),
        "action, postures and movements": _listed(POSES, ACTION_PHRASES.__getitem__),
        "action, others": _listed(OTHER_ACTIONS, ACTION_PHRASES.__getitem__),
        "interaction": _listed(
            INTERACTIONS, lambda label: INTERACTION_PHRASES[label].removesuffix(" with someone").replace(" someone", "")
        ),
        "relation": _relations(),
        "verb": _listed(VERBS, VERB_PHRASES.__getitem__),
        "object": _listed(OBJECTS, _thing),
    }
    return "\n".join(f"- {kind}: {labels}." for kind, labels in lines.items())


def _relations() -> str:
    """Relations but for the interactions, which are relations as well; those of a kind by an example."""
    rows = [RELATIONS[label] for label in QUESTION_RELATIONS]
    window = next(row.label for row in rows if row.kind == "window")
    near = dict.fromkeys(row.distance for row in rows if row.kind == "person")
    beside = person_frame_label("front left", "close")
    return (
        f"every interaction; {SAME_GROUP}; {FIRST_LEFT}; {FIRST_RIGHT}; {window}, likewise to the right of, and with "
        f"{', '.join(map(str, WINDOW_DEGREES[1:]))} for {WINDOW_DEGREES[0]}; where the target is from the source's own "
        f"point of view and how far from the source, as in {beside}: one of {', '.join(PERSON_SECTORS)}, a comma and "
        f"one of {', '.join(near)}"
    )


def _listed(labels: Collection[str], words: Callable[[str], str] = str) -> str:
    return ", ".join(label if words(label) == label else f"{label} = {words(label)}" for label in labels)


def _thing(category: str) -> str:
    """A thing's words, or the label where they say no more than it does."""
    words = OBJECT_PHRASES[category]
    for article in ("a ", "an ", "the ", "some "):
        words = words.removeprefix(article)
    return category if words == category.replace("_", " ") else words


def check_labels(plan: Plan) -> None:
    """Refuse a plan with a label that nothing is ever called. Raises PlanError naming the field."""
    for i, node in enumerate(plan.nodes):
        for j, condition in enumerate(node.conditions):
            _check_condition(f"nodes[{i}].conditions[{j}]", condition)
        _check(f"nodes[{i}].kind", plan.things.get(node.id), THINGS)
    for i, edge in enumerate(plan.edges):
        if edge.target not in plan.things:
            _check(f"edges[{i}].relation", edge.relation, QUESTION_RELATIONS)
        elif edge.relation in INTERACTIONS:
            raise PlanError(f"edges[{i}].relation", f"{edge.relation!r} joins two people; use a verb or words of yours")
    for name, moment in plan.times.items():
        _check(f"times.{name}.action", moment.action, ACTIONS)
    _check("answer.relation", plan.answer.relation, RELATIONS_OF["count"])


def _check_condition(field: str, condition: Condition) -> None:
    for name, labels in _LABELS.items():
        _check(f"{field}.{name}", getattr(condition, name), labels)
    if condition.attribute == "group_size":
        if not isinstance(condition.value, int) or not 1 <= condition.value <= 1000:
            raise PlanError(f"{field}.value", "is the number of people in the group, 1 or more")
    elif condition.attribute in _VALUES:
        _check(f"{field}.value", str(condition.value), _VALUES[condition.attribute])


def _check(field: str, label: str | None, labels: Collection[str]) -> None:
    if label is not None and label not in labels:
        near = difflib.get_close_matches(label, labels, 1)
        instead = hint("relation", label) if field.endswith("relation") else ""
        raise PlanError(
            field, f"{label!r} is none of the labels" + (instead or (f"; perhaps {near[0]!r}" if near else ""))
        )
