"""The plan stage: the request for a plan, and the check of the plan before the first look."""

from __future__ import annotations

import difflib
import functools
import json
import re
import time
from collections.abc import Callable, Collection
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import msgspec

from jrdb_avr.agent.look.ranking import parts_of
from jrdb_avr.agent.methods.attempt import Attempt
from jrdb_avr.agent.methods.requests import heading
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.messages import Message
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.perceive.fields import perceivable
from jrdb_avr.agent.reference.turns import compact_json, printable
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
    from jrdb_avr.agent.world.episode import WorldEpisode

LONGEST_SENT: Final = 4000
"""Maximum number of characters of a refused plan that are sent again."""

MOST_PARTS: Final = 32
"""Maximum number of conditions and edges of a plan. The plan of a question has about a dozen."""


def make_plan(attempt: Attempt, repairs: int, episode: WorldEpisode) -> Plan:
    """Let the model plan the question. Each try is one model call, which states why the last plan was refused.

    Args:
        attempt: The attempt at the question.
        repairs: Maximum number of tries after a refused plan.
        episode: The world model's episode, which records every try.

    Returns:
        The model's plan, or the smallest plan if all tries are refused.

    Raises:
        EndpointError: If the server refuses a request.
    """
    task = attempt.task
    frames = task.sequence.frames or (0,)
    system, schema = plan_prompt(task), plan_form()
    refusal, text = "", ""
    for _ in range(1 + repairs):
        user = render(
            "agent_plan_task",
            heading=heading(task.question),
            frames=f"{frames[0]:06d} to {frames[-1]:06d}",
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
            # A part that holds at no stated frame cannot be looked for.
            parts_of(perceivable(plan))
        except (DecodeError, PlanError) as error:
            refusal = printable(str(error))
            arguments = compact_json(value) if len(text) <= LONGEST_SENT else "{}"
            episode.refuse("plan", msgspec.Raw(arguments.encode()), refusal, step)
            attempt.record("tool", {"tool": "plan"}, {"refused": refusal}, started)
            text = text[:LONGEST_SENT]
        else:
            episode.set_plan(plan, step)
            attempt.record("tool", {"tool": "plan"}, {"accepted": canonical(plan)}, started)
            return plan
    plan = smallest_plan(task)
    episode.set_plan(plan, step)
    attempt.record("tool", {"tool": "plan"}, {"in place of a plan": canonical(plan)}, time.perf_counter())
    return plan


def smallest_plan(task: Task) -> Plan:
    """Return the plan that is used if no other plan was accepted: one person without conditions.

    Args:
        task: The question.

    Returns:
        The plan. The answer mode of the question decides what it reads.
    """
    mode, frames = task.question.answer_mode, task.sequence.frames or (0,)
    read = MODES[mode].smallest_read
    times = {"t0": Time(frame=frames[0])}
    at: list[str] = []
    # The action of an event and the relation of a count are unknown, so the most frequent labels are used.
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
    """Read the plan of a question.

    Args:
        text: The plan as JSON.
        task: The question.

    Returns:
        The plan.

    Raises:
        PlanError: If the plan is invalid, has another answer mode than the question, has an unknown label, or has a
            frame outside the sequence. The error names the field.
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
        raise PlanError("plan", f"the maximum is {MOST_PARTS} conditions and edges, not {count}")
    check_labels(plan)
    return plan


def plan_prompt(task: Task) -> str:
    """Return the system message of the plan stage.

    Args:
        task: The question.

    Returns:
        The text, with the labels that a plan may have.
    """
    mode = task.question.answer_mode
    return render(
        "agent_plan",
        fps=f"{task.sequence.fps:g}",
        mode=mode,
        reads=render(f"agent_reads_{mode}"),
        vocabulary=vocabulary(task.question.question),
    )


@cache
def plan_form() -> dict[str, Any]:
    """Return the JSON Schema of a plan, without descriptions and without null values."""
    form: dict[str, Any] = json.loads(json.dumps(plan_json_schema()), object_hook=_plain)
    return form


def _plain(node: dict[str, Any]) -> dict[str, Any]:
    plain = {key: value for key, value in node.items() if key not in _LEFT_OUT}
    named = [option for option in plain.pop("anyOf", ()) if option != {"type": "null"}]
    return plain | ({"anyOf": named} if len(named) > 1 else dict(*named))


_LEFT_OUT: Final = frozenset({"title", "description", "default", "propertyNames", "minLength", "maxLength"})


# -- labels -----------------------------------------------------------------------------------------------------------

THINGS: Final = tuple(category for category in OBJECTS if category not in PERSON_CATEGORIES)
"""Kinds of nodes for things."""

_LABELS: Final = {"action": ACTIONS, "interaction": INTERACTIONS, "object": OBJECTS, "verb": VERBS}
"""Labels of a condition, by field."""

_VALUES: Final = {"gender": GENDERS, "age": AGES, "sector": tuple(ROBOT_SECTORS), "distance": DISTANCE_WORDS}
"""Values of attributes that have labels."""

_AGE_PHRASES: Final = dict(zip(AGES, ("child", "teenager", "young", "middle-aged", "elderly"), strict=True))


def vocabulary(question: str) -> str:
    """List the labels that a plan may have.

    Args:
        question: The text of the question.

    Returns:
        One line per kind of label. If the question has other phrases for a label, they follow the label:
        `bending = bending down`. Of the longest kinds, only labels with a word of the question are listed.
    """
    near = functools.partial(_named, question)
    lines = {
        "gender": _listed(GENDERS),
        "age": _listed(AGES, _AGE_PHRASES.__getitem__),
        "sector": _listed(ROBOT_SECTORS),
        "distance": _listed(DISTANCE_WORDS, lambda word: FAR_AWAY[word].rpartition("(")[2].rstrip(")")),
        "action, postures and movements": _listed(POSES, ACTION_PHRASES.__getitem__),
        "action, others": _listed(near(OTHER_ACTIONS, ACTION_PHRASES.__getitem__), ACTION_PHRASES.__getitem__),
        "interaction": _listed(near(INTERACTIONS, _interaction), _interaction),
        "relation": _relations(),
        "verb": _listed(near(VERBS, VERB_PHRASES.__getitem__), VERB_PHRASES.__getitem__),
        "object": _listed(near(OBJECTS, _thing), _thing),
    }
    return "\n".join(f"- {kind}: {labels}." for kind, labels in lines.items() if labels)


def _named(question: str, labels: Collection[str], phrases: Callable[[str], str]) -> list[str]:
    """Return the labels that share the first three letters of a word with the question."""
    stems = _stems(question)
    return [label for label in labels if stems & _stems(f"{label} {phrases(label)}")]


def _interaction(label: str) -> str:
    return INTERACTION_PHRASES[label].removesuffix(" with someone").replace(" someone", "")


def _stems(text: str) -> set[str]:
    return {word[:3] for word in re.findall("[a-z]{3,}", text.lower())}


def _relations() -> str:
    """List the relations, without the interactions. A kind with many labels is shown by an example."""
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


def _listed(labels: Collection[str], phrases: Callable[[str], str] = str) -> str:
    return ", ".join(label if phrases(label) == label else f"{label} = {phrases(label)}" for label in labels)


def _thing(category: str) -> str:
    """Return the phrases of a question for a thing, or the label if it equals the phrases."""
    phrases = re.sub("^(a|an|the|some) ", "", OBJECT_PHRASES[category])
    return category if phrases == category.replace("_", " ") else phrases


def check_labels(plan: Plan) -> None:
    """Check the labels of a plan.

    Args:
        plan: The plan.

    Raises:
        PlanError: If a label is unknown. The error names the field.
    """
    for i, node in enumerate(plan.nodes):
        for j, condition in enumerate(node.conditions):
            _check_condition(f"nodes[{i}].conditions[{j}]", condition)
        _check(f"nodes[{i}].kind", plan.things.get(node.id), THINGS)
    for i, edge in enumerate(plan.edges):
        if edge.target not in plan.things:
            _check(f"edges[{i}].relation", edge.relation, QUESTION_RELATIONS)
        elif edge.relation in INTERACTIONS:
            raise PlanError(f"edges[{i}].relation", f"{edge.relation!r} joins two people; use a verb or other phrases")
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
