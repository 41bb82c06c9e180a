"""The plan: the program of a question, as a small typed pattern of people, things, relations and times.

The gold programs of questions and the plans of agents have this schema. A node is a person, or a thing that people
relate to. Conditions and edges hold at named times. A time is a stated frame, an event that is found in the data, or a
moment between such times. The answer names the read, its person and its times. `parse_plan` and `validate` refuse a
plan that cannot run, and name the faulty field. `canonical` returns the byte-stable text that is hashed and stored.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, NamedTuple, get_args

import msgspec

from jrdb_avr.schema.answers import AnswerMode
from jrdb_avr.schema.beliefs import TIMELESS, free_value
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.plan_hints import FREE, hint, hint_for

Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64, pattern="^[a-z][a-z0-9_]*$")]
Label = Annotated[str, msgspec.Meta(min_length=1, max_length=120)]
MOST_PEOPLE: Final = 10_000
"""Maximum size of a group in a plan."""

_Frame = Annotated[int, msgspec.Meta(ge=0, le=10_000_000)]

GroupEvent = Literal["joins_group", "leaves_group"]
GROUP_EVENTS: Final[tuple[GroupEvent, ...]] = get_args(GroupEvent)
"""Events of a person's membership in a group of two people or more. Conditions and edges may hold at them.

In a frame with a box, a person is in a group if easy or medium labels put the person and another person in one group.
A person is alone if such a label names a group that no other label of the frame names. Otherwise it is unknown.
`joins_group` is the first frame after `after` in a group if the person was alone in the preceding box. `leaves_group`
is the first frame alone after a box in a group. The two boxes are at most 15 frames apart.
"""

Event = Literal["start", "end", "leaves", "returns", GroupEvent]
Read = Literal[
    "action",
    "attribute",
    "presence",
    "distance_change",
    "next_action",
    "start",
    "span",
    "start_view",
    "seconds_between",
    "count",
]
Attribute = Literal["gender", "age", "group_size", "sector", "distance"]
ATTRIBUTES: Final[tuple[Attribute, ...]] = get_args(Attribute)
"""The attributes with labels, and the size of a group. An attribute with any other name is free.

An agent chooses the name and the value of a free attribute. A belief fulfils it if it has the same name and value.
"""
AttributeName = Annotated[str, msgspec.Meta(min_length=1, max_length=40, pattern="^[a-z][a-z0-9_]*$")]


class ReadRule(NamedTuple):
    """Requirements of a read: the answer mode, and the kinds of event of each time of the answer (empty: any time)."""

    mode: AnswerMode
    times: tuple[tuple[Event, ...], ...]


READS: Final[dict[Read, ReadRule]] = {
    "action": ReadRule("multiple_choice", ((),)),
    "attribute": ReadRule("multiple_choice", ((),)),
    "presence": ReadRule("multiple_choice", ((), ())),
    "distance_change": ReadRule("multiple_choice", ((), ())),
    "next_action": ReadRule("multiple_choice", (("end",),)),
    "start": ReadRule("frame", (("start", *GROUP_EVENTS),)),
    "span": ReadRule("span", (("start",), ("end",))),
    "start_view": ReadRule("frame_viewpoint", (("start",),)),
    "seconds_between": ReadRule("number", (("start", "leaves"), ("start", "returns"))),
    "count": ReadRule("number", ((), ())),
}


class Time(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """A stated frame, the first event of a kind after another time, or some moment `before` or `after` other times.

    The events `start` and `end` name the `action` that starts or ends. All other events name no action. If the read is
    `next_action`, `end` names no action: it is the end of the pose at the time `after`. The times of a moment, and the
    time `after` of an event of `GROUP_EVENTS`, are stated frames. A moment may also be before or after such an event.
    """

    frame: _Frame | None = None
    event: Event | None = None
    of: Name | None = None
    action: Label | None = None
    after: Name | None = None
    before: Name | None = None

    @property
    def is_moment(self) -> bool:
        """Whether the time is some frame between other times, in which all parts of the plan at this time hold."""
        return self.frame is None and self.event is None

    @property
    def is_group_event(self) -> bool:
        """Whether the time is an event of `GROUP_EVENTS`."""
        return self.event in GROUP_EVENTS


class Condition(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True, cache_hash=True):
    """A fact of a person: the value of an attribute, an action, a handled object, or a labelled interaction.

    Exactly one of `attribute` (with `value`), `action`, `object` (with `verb`) and `interaction` is given. Gender and
    age hold at all times. All other conditions hold `at` a time. An attribute outside `ATTRIBUTES` is free.
    """

    attribute: Annotated[AttributeName, msgspec.Meta(examples=[*ATTRIBUTES])] | None = None
    value: Label | int | None = None
    action: Label | None = None
    object: Label | None = None
    verb: Label | None = None
    interaction: Label | None = None
    at: Name | None = None

    @property
    def kind(self) -> str:
        """Kind of the condition: one of `rules.CONDITION_KINDS` (an attribute, pose, action, ...), or "free"."""
        if self.attribute is not None:
            return self.attribute if self.attribute in ATTRIBUTES else "free"
        if self.action is not None:
            return "pose" if self.action in POSES else "action"
        return "object" if self.object is not None else "interaction"

    @property
    def words(self) -> str:
        """The condition in a few words, as in "action sitting", "sector left" or "object bag (carrying)"."""
        if self.attribute is not None:
            return f"{self.attribute} {self.value}"
        if self.object is not None:
            return f"object {self.object} ({self.verb})"
        return f"interaction {self.interaction}" if self.action is None else f"action {self.action}"

    @property
    def wanted(self) -> tuple[str, str]:
        """Name and value of the belief that fulfils the condition, as an agent writes them."""
        if self.attribute is not None:
            text = str(self.value)
            return self.attribute, text if self.attribute in ATTRIBUTES else free_value(text)
        if self.action is not None:
            return "action", self.action
        if self.object is not None:
            return "object", f"{self.verb}: {self.object}"
        return "interaction", self.interaction or ""


PERSON: Final = "person"


class Node(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A person of the pattern, or a thing of a `kind` (its category). Different nodes are different people or things.

    The conditions of a thing are free attributes.
    """

    id: Name
    conditions: Annotated[tuple[Condition, ...], msgspec.Meta(max_length=8)] = ()
    kind: Label | msgspec.UnsetType = msgspec.UNSET


class Edge(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A relation from `source` to `target` at a time.

    If the target is a thing, the relation is a verb such as "holding", a window of the robot's view, or free words such
    as "next to".
    """

    source: Name
    relation: Label
    target: Name
    at: Name

    @property
    def wanted(self) -> str:
        """Name of the relation that fulfils the edge, as an agent writes it."""
        return free_value(self.relation)


class AnswerSpec(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """The read of the answer: `read` of node `of` at one time, or at a list of times.

    The read `count` counts the people who are in `relation` with `of` at any frame from the first of two stated times
    to the second. The read `attribute` returns the value of `attribute`. Only this read may be of a thing.
    """

    mode: AnswerMode
    read: Read
    of: Name
    at: Name | tuple[Name, ...]
    relation: Label | None = None
    attribute: AttributeName | None = None

    @property
    def times(self) -> tuple[str, ...]:
        """Names of the times at which the answer is read."""
        return (self.at,) if isinstance(self.at, str) else self.at


class Plan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A program: nodes and edges at named times. The search begins at `root`, and the answer is about `target`."""

    root: Name
    target: Name
    times: Annotated[dict[Name, Time], msgspec.Meta(max_length=16)]
    nodes: Annotated[tuple[Node, ...], msgspec.Meta(min_length=1, max_length=16)]
    edges: Annotated[tuple[Edge, ...], msgspec.Meta(max_length=32)]
    answer: AnswerSpec

    @property
    def things(self) -> dict[str, str]:
        """Kind of each node that is a thing, by the node."""
        return {node.id: node.kind for node in self.nodes if node.kind and node.kind != PERSON}

    @property
    def ways(self) -> list[tuple[str, str]]:
        """Pairs of nodes in the directions of the search: from source to target, and back from a thing."""
        things = self.things
        return [(e.source, e.target) for e in self.edges] + [
            (e.target, e.source) for e in self.edges if e.target in things
        ]


# Made at import, because the decoder crashes if two threads use a new type at the same time.
_DECODER: Final = msgspec.json.Decoder(Plan)
_TIMES: Final = msgspec.json.Decoder(dict[Name, Time])


def parse_plan(text: str | bytes) -> Plan:
    """Read a plan from JSON and validate it.

    Args:
        text: JSON of the plan.

    Returns:
        The plan.

    Raises:
        PlanError: If the text is not JSON or not a valid plan. The error names the faulty field.
    """
    try:
        plan = _DECODER.decode(text)
    except msgspec.ValidationError as error:
        message, _, where = str(error).partition(" - at `")
        where = where.replace("key` in `$.times", "$.times[...]").strip("`$.")
        if "[...]" in where:
            where = where.replace("times[...]", f"times.{_bad_time(text)}")
        # An unknown key is in the message as it was written, with its white space.
        words = " ".join((message + hint_for(where, message)).split())
        raise PlanError(" ".join(where.split()) or "plan", words) from None
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise PlanError("plan", f"not JSON: {error}") from None
    validate(plan)
    return plan


def _bad_time(text: str | bytes) -> str:
    """Return the name of the first time that cannot be read, because the decoder's message does not name it.

    The result is "..." if the text is not JSON after the position at which the decoder stopped.
    """
    try:
        times: dict[str, Any] = msgspec.json.decode(text, type=dict[str, Any])["times"]
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return "..."
    # If a key is given twice, this decoder has read the last one.
    for name, time in times.items() if isinstance(times, dict) else ():
        try:
            _TIMES.decode(msgspec.json.encode({name: time}))
        except msgspec.ValidationError:
            return name
    return "..."


def canonical(plan: Plan) -> str:
    """Return the JSON text of a plan with sorted keys, without spaces and defaults. Equal plans have equal texts."""
    return msgspec.json.encode(plan, order="sorted").decode()


def plan_json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a plan."""
    return msgspec.json.schema(Plan)


def validate(plan: Plan) -> None:
    """Refuse a plan that cannot run.

    Args:
        plan: Plan.

    Raises:
        PlanError: If the plan has a fault. The error names the field of the first fault.
    """
    ids = [node.id for node in plan.nodes]
    for position, identifier in enumerate(ids):
        if identifier in ids[:position]:
            raise PlanError(f"nodes[{position}].id", f"{identifier!r} is used twice")
    for name, value in (("root", plan.root), ("target", plan.target)):
        _known(name, value, ids, "node")
    if plan.target in plan.things and plan.answer.read != "attribute":
        raise PlanError("target", f"{plan.target!r} is a thing; of a thing only the read 'attribute' is possible")
    _check_times(plan, ids)
    for i, node in enumerate(plan.nodes):
        for j, condition in enumerate(node.conditions):
            _check_condition(f"nodes[{i}].conditions[{j}]", condition, plan)
            if node.id in plan.things and condition.kind != "free":
                raise PlanError(f"nodes[{i}].conditions[{j}]", f"is said of people; of a thing use {FREE}")
    for i, edge in enumerate(plan.edges):
        _known(f"edges[{i}].source", edge.source, ids, "node")
        _known(f"edges[{i}].target", edge.target, ids, "node")
        _known(f"edges[{i}].at", edge.at, list(plan.times), "time")
        if edge.source == edge.target:
            raise PlanError(f"edges[{i}].target", "an edge joins two different nodes")
        if edge.source in plan.things:
            raise PlanError(f"edges[{i}].source", f"{edge.source!r} is a thing; use an edge from the person to it")
    _check_reach(plan)
    _check_answer(plan, ids)


def _known(field: str, value: str, names: list[str], kind: str) -> None:
    if value not in names:
        raise PlanError(field, f"unknown {kind} {value!r}; known: {', '.join(names) or 'none'}")


def _check_times(plan: Plan, ids: list[str]) -> None:
    if not plan.times:
        raise PlanError("times", "at least one time is needed")
    for name, time in plan.times.items():
        field = f"times.{name}"
        if time.frame is not None and time.event is not None:
            raise PlanError(field, "give either a frame or an event")
        if time.is_moment:
            _check_moment(field, time, plan)
            continue
        if time.before is not None:
            raise PlanError(f"{field}.before", 'belongs to a moment; use {"before": "t0"} alone')
        if time.frame is not None:
            for key in ("of", "action", "after"):
                if getattr(time, key) is not None:
                    raise PlanError(f"{field}.{key}", "belongs to an event, not to a frame")
            continue
        if time.of is None or time.after is None:
            raise PlanError(field, "an event needs 'of' and 'after'")
        _known(f"{field}.of", time.of, [name for name in ids if name not in plan.things], "person")
        _known(f"{field}.after", time.after, [name for name in plan.times if not plan.times[name].is_moment], "time")
        unnamed = time.event == "end" and plan.answer.read == "next_action" and name in plan.answer.times
        if time.action is None and time.event in ("start", "end") and not unnamed:
            raise PlanError(f"{field}.action", "is needed by start and end (but for the end before a next_action)")
        if time.action is not None and time.event not in ("start", "end"):
            raise PlanError(f"{field}.action", f"belongs to start and end, not to {time.event!r}")
        if time.is_group_event and plan.times[time.after].frame is None:
            raise PlanError(f"{field}.after", f"{time.after!r} is no stated frame, which {time.event!r} needs")
    for name in plan.times:
        seen = {name}
        after = plan.times[name].after
        while after is not None:
            if after in seen:
                raise PlanError(f"times.{name}.after", "events wait for each other in a circle")
            seen.add(after)
            after = plan.times[after].after


def _check_moment(field: str, time: Time, plan: Plan) -> None:
    if time.before is None and time.after is None:
        raise PlanError(field, "give a frame, an event, or the time before or after which it is")
    for key in ("of", "action"):
        if getattr(time, key) is not None:
            raise PlanError(f"{field}.{key}", "belongs to an event, as start")
    for key in ("before", "after"):
        if getattr(time, key) is not None:
            bounds = [name for name, bound in plan.times.items() if bound.frame is not None or bound.is_group_event]
            _known(f"{field}.{key}", getattr(time, key), bounds, "stated frame or group event")


def _check_condition(field: str, condition: Condition, plan: Plan) -> None:
    kinds = [k for k in ("attribute", "action", "object", "interaction") if getattr(condition, k) is not None]
    if len(kinds) != 1:
        raise PlanError(field, "give exactly one of attribute, action, object and interaction")
    if (condition.attribute is None) != (condition.value is None):
        raise PlanError(f"{field}.value", "goes with 'attribute', and only with it")
    _check_attribute(f"{field}.attribute", condition.attribute)
    if condition.attribute is not None and (condition.attribute == "group_size") != isinstance(condition.value, int):
        raise PlanError(f"{field}.value", "is a whole number for group_size and a text for all else")
    if isinstance(condition.value, int) and not 0 <= condition.value <= MOST_PEOPLE:
        raise PlanError(f"{field}.value", f"is a number of people, from 0 to {MOST_PEOPLE}")
    if (condition.object is None) != (condition.verb is None):
        raise PlanError(f"{field}.verb", "goes with 'object', and only with it")
    if condition.attribute in TIMELESS:
        if condition.at is not None:
            raise PlanError(f"{field}.at", f"{condition.attribute} holds at any time")
    elif condition.at is None:
        raise PlanError(f"{field}.at", "name the time at which this holds")
    else:
        _known(f"{field}.at", condition.at, list(plan.times), "time")


def _check_attribute(field: str, name: str | None) -> None:
    if name is not None and (instead := hint("attribute", name)):
        raise PlanError(field, f"{name!r} is no attribute{instead}")


def _check_reach(plan: Plan) -> None:
    reached = {plan.root}
    for _ in plan.nodes:
        reached |= {target for source, target in plan.ways if source in reached}
    for i, node in enumerate(plan.nodes):
        if node.id not in reached:
            field = "target" if node.id == plan.target else f"nodes[{i}].id"
            raise PlanError(field, f"{node.id!r} is not reached from the root {plan.root!r} along edges")


def _check_answer(plan: Plan, ids: list[str]) -> None:
    answer = plan.answer
    known = [name for name in ids if answer.read == "attribute" or name not in plan.things]
    _known("answer.of", answer.of, known, "node")
    times = plan.answer.times
    for name in times:
        _known("answer.at", name, list(plan.times), "time")
        if plan.times[name].is_moment:
            raise PlanError("answer.at", f"{name!r} is some moment; use a stated frame, or an event")
    rule = READS[answer.read]
    if rule.mode != answer.mode:
        raise PlanError("answer.mode", f"{answer.mode!r} does not fit the read {answer.read!r}; use {rule.mode!r}")
    if len(times) != len(rule.times):
        raise PlanError("answer.at", f"the read {answer.read!r} names {len(rule.times)} time(s)")
    if (answer.relation is None) != (answer.read != "count"):
        raise PlanError("answer.relation", "is needed by the read 'count', and by nothing else")
    if (answer.attribute is None) != (answer.read != "attribute"):
        raise PlanError("answer.attribute", "is needed by the read 'attribute', and by nothing else")
    _check_attribute("answer.attribute", answer.attribute)
    if len(set(times)) < len(times):
        raise PlanError("answer.at", f"names {times[0]!r} twice")
    for name, kinds in zip(times, rule.times, strict=True):
        time = plan.times[name]
        if not kinds:
            continue
        if time.event not in kinds:
            wanted = " or ".join(repr(kind) for kind in kinds)
            raise PlanError("answer.at", f"the read {answer.read!r} needs {name!r} to be an event {wanted}")
        if time.of != answer.of:
            raise PlanError(f"times.{name}.of", f"the answer is read of {answer.of!r}, so the event is too")
    if answer.read == "count":
        first, last = (plan.times[name].frame for name in times)
        if first is None or last is None or first >= last:
            raise PlanError("answer.at", "the read 'count' needs two stated frames, the earlier first")
