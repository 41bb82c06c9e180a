"""Fields of a person: what a model is asked about each person of a picture, and how its reply is read.

Closed attributes, such as the posture, are asked by all their labels. Statements, such as actions and relations, are
mixed with statements that the plan does not need, so that a model that agrees with everything gains nothing. "no" is
evidence; `CANNOT_TELL` is not.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple

import msgspec

from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.conventions import Convention
from jrdb_avr.agent.model.decode import box_key, finite, read_box
from jrdb_avr.agent.perceive.geometry import DERIVED
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie, topic_of
from jrdb_avr.queries.compiler.find import limits
from jrdb_avr.schema.beliefs import ALWAYS, free_value
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.labels import AGES, GENDERS, INTERACTIONS, OTHER_ACTIONS, POSES, answer_of_choice
from jrdb_avr.schema.panorama import from_crop
from jrdb_avr.schema.plan import ATTRIBUTES, Condition, Edge, Node, Plan, Time, canonical
from jrdb_avr.schema.relations import QUESTION_RELATIONS, RELATIONS, SAME_GROUP
from jrdb_avr.schema.rules import FPS
from jrdb_avr.schema.things import OBJECTS, VERBS

MOST_PEOPLE: Final = 10
"""Maximum number of people in one call."""

SAME_PLACE: Final = 0.95
"""Minimum IoU at which two boxes in one call are one box."""

CANNOT_TELL: Final = "cannot tell"
_LONGEST_WORDS: Final = 40
"""Maximum number of characters of a free attribute's value."""

_AWAY: Final = round(2 * FPS)
"""Number of frames between the limit of a moment and the frame that is looked at for it."""

_LABELS: Final = {"gender": GENDERS, "age": AGES, "pose": POSES}
_HANDLING: Final = ("carrying", "holding", "pushing", "touching")
_OTHERS: Final = {
    "action": OTHER_ACTIONS,
    "interaction": INTERACTIONS,
    "object": tuple(f"{verb}: {thing}" for verb in _HANDLING for thing in OBJECTS),
    "relation": tuple(label for label in QUESTION_RELATIONS if label not in DERIVED),
}
"""Statements that fields ask for beside the statements that a plan needs."""

_TAKEN: Final = frozenset({*ATTRIBUTES, *_LABELS, *_OTHERS})
"""Names of attributes that are never free."""


class Field(NamedTuple):
    """One thing to read of each person.

    kind: a closed attribute ("labels"), a free attribute ("words"), a statement, a distance or a relation.
    """

    kind: Literal["labels", "words", "statement", "metres", "relation"]
    name: str
    value: str = ""

    @property
    def key(self) -> str:
        """The field's key in a reply."""
        keys = {"labels": self.name, "metres": "distance_m", "words": f"attribute {self.name}"}
        return keys.get(self.kind) or f"{self.name} {self.value}"

    @property
    def words(self) -> tuple[str, ...]:
        """The permitted words of a closed attribute or a statement."""
        return (*(_LABELS[self.name] if self.kind == "labels" else ("yes", "no")), CANNOT_TELL)

    def form(self) -> Any:
        """Return the description of the field for a prompt, which allows `CANNOT_TELL` for every field."""
        forms = {"metres": "number", "relation": "ids of people", "words": "one or two words", "statement": "yes/no"}
        return forms.get(self.kind) or _LABELS[self.name]

    def schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the field's value."""
        if self.kind == "metres":
            return {"type": ["number", "null"]}
        if self.kind == "relation":
            return {"type": ["array", "null"], "items": {"type": "string"}, "maxItems": MOST_PEOPLE}
        if self.kind == "words":
            return {"type": "string", "minLength": 1, "maxLength": _LONGEST_WORDS}
        return {"type": "string", "enum": list(self.words)}


# -- plans ------------------------------------------------------------------------------------------------------------


def perceivable(plan: Plan, changes: Mapping[str, int] = MappingProxyType({})) -> Plan:
    """Return the plan in the form that pictures can show: people only, at stated frames.

    A relation to a thing becomes a condition, and an attribute that is read of a thing becomes the person's. The
    identity of a thing, its place, and free relations with a name in `ATTRIBUTES` are left out. A moment becomes the
    frame two seconds from its limit, or in the middle of two. Facts at a group event hold at its frame.

    Args:
        plan: Plan.
        changes: Known frames of group events, by time. An unknown event is expected two seconds after its time `after`.

    Returns:
        The plan for pictures.
    """
    plan = _at_frames(plan, changes)
    things = plan.things
    people = [node for node in plan.nodes if node.id not in things]
    joins = [edge for edge in plan.edges if edge.target in things and edge.relation not in RELATIONS]
    joins = [edge for edge in joins if edge.relation in VERBS or _free_name(edge) not in _TAKEN]
    added = [(edge.source, _of_thing(edge, things[edge.target])) for edge in joins]
    nodes = tuple(
        Node(node.id, (*node.conditions, *(part for end, part in added if end == node.id))) for node in people
    )
    answer, target = plan.answer, plan.target
    if answer.of in things:
        holder = next((edge.source for edge in plan.edges if edge.target == answer.of), people[0].id)
        target = holder if target == answer.of else target
        free = answer.attribute if answer.attribute in ATTRIBUTES else f"{things[answer.of]} {answer.attribute}"
        answer = msgspec.structs.replace(answer, of=holder, attribute=str(free).replace(" ", "_"))
    root = target if plan.root in things else plan.root
    edges = tuple(edge for edge in plan.edges if edge.target not in things)
    return msgspec.structs.replace(plan, root=root, target=target, nodes=nodes, edges=edges, answer=answer)


def _at_frames(plan: Plan, changes: Mapping[str, int]) -> Plan:
    """Replace moments by frames, and let the facts of each group event hold at a stated frame."""
    events = {name: time for name, time in plan.times.items() if time.is_group_event}
    frames = {
        name: Time(frame=changes.get(name, (plan.times[time.after or ""].frame or 0) + _AWAY))
        for name, time in events.items()
    }
    dated = msgspec.structs.replace(plan, times=plan.times | frames)
    moments = {name: Time(frame=_frame(dated, name)) for name, time in plan.times.items() if time.is_moment}
    times = plan.times | moments | {f"{name}_frame": time for name, time in frames.items()}
    nodes = tuple(
        msgspec.structs.replace(node, conditions=tuple(_at_frame(part, events) for part in node.conditions))
        for node in plan.nodes
    )
    edges = tuple(_at_frame(edge, events) for edge in plan.edges)
    return msgspec.structs.replace(plan, times=times, nodes=nodes, edges=edges)


def _at_frame(part: Any, events: Mapping[str, Time]) -> Any:
    """Return a condition or an edge that holds at the frame of its event."""
    return msgspec.structs.replace(part, at=f"{part.at}_frame") if part.at in events else part


def _frame(plan: Plan, moment: str) -> int:
    after, before = limits(plan, moment) or (-1, ALWAYS)
    if before < ALWAYS:
        return (after + before) // 2 if after >= 0 else max(0, before - _AWAY)
    return after + _AWAY


def _of_thing(edge: Edge, kind: str) -> Condition:
    if edge.relation in VERBS:
        return Condition(object=kind, verb=edge.relation, at=edge.at)
    return Condition(attribute=_free_name(edge), value=kind, at=edge.at)


def _free_name(edge: Edge) -> str:
    return edge.wanted.replace(" ", "_")


# -- fields of a plan -------------------------------------------------------------------------------------------------


def fields_of(plan: Plan, choices: Sequence[str] = ()) -> tuple[Field, ...]:
    """Return the fields that a plan needs, among other statements, in an order that gives nothing away.

    If the plan asks for an action, each offered action is a field.

    Args:
        plan: The plan, as `perceivable` returns it.
        choices: The choices of the question.

    Returns:
        The fields.
    """
    needed = dict.fromkeys(_needed(plan))
    if plan.answer.read == "action":
        needed |= dict.fromkeys(_offered(choices))
    for field in [field for field in needed if field.value]:
        rest = [extra for value in _OTHERS[field.name] if (extra := field._replace(value=value)) not in needed]
        needed |= dict.fromkeys(sorted(rest, key=lambda extra: _shuffled(plan, extra))[:1])
    order = sorted((field for field in needed if field.value), key=lambda field: _shuffled(plan, field))
    return (*(field for field in needed if not field.value), *order)


def _needed(plan: Plan) -> Iterator[Field]:
    answer = plan.answer
    # Gender and age are always read, because people are recognized by them.
    yield Field("labels", "gender")
    yield Field("labels", "age")
    needs = [condition.wanted for node in plan.nodes for condition in node.conditions]
    needs += [] if answer.attribute is None else [(answer.attribute, "")]
    needs += [("group_size", "") for time in plan.times.values() if time.is_group_event]
    needs += [("action", time.action) for time in plan.times.values() if time.action is not None]
    for name, value in needs:
        if name == "group_size":
            yield Field("relation", "relation", SAME_GROUP)
        elif name == "distance":
            yield Field("metres", "distance")
        elif topic_of(name, value) in _LABELS:
            yield Field("labels", topic_of(name, value))
        elif name in _OTHERS:
            yield Field("statement", name, value)
        elif name not in ATTRIBUTES:
            yield Field("words", name)
    if answer.read == "next_action":
        yield Field("labels", "pose")
    if answer.read == "distance_change":
        yield Field("metres", "distance")
    for relation in (*(edge.relation for edge in plan.edges), answer.relation):
        if relation is not None and relation not in DERIVED:
            yield Field("relation", "relation", relation)


def _offered(choices: Sequence[str]) -> Iterator[Field]:
    for label in map(answer_of_choice, choices):
        if label in POSES:
            yield Field("labels", "pose")
        elif label in OTHER_ACTIONS:
            yield Field("statement", "action", label)


def _shuffled(plan: Plan, field: Field) -> str:
    return hashlib.sha256(f"{canonical(plan)} {field.key}".encode()).hexdigest()


# -- a reply ----------------------------------------------------------------------------------------------------------


def read_person(
    value: object,
    index: int,
    numbers: Mapping[str, int],
    fields: Sequence[Field],
    name: str,
    frame: int,
    left: float,
    size: tuple[int, int],
    convention: Convention,
) -> PersonReading:
    """Read one person of a reply. The reply is untrusted.

    Args:
        value: The person: an object with a box and all fields.
        index: Number of the person in the picture.
        numbers: Numbers of the people of the same call, by id.
        fields: The fields.
        name: Name of the picture's observation.
        frame: Frame of the picture.
        left: Column of the panorama at the left edge of the picture, in stitched pixels.
        size: Width and height of the picture in pixels.
        convention: How the model writes boxes.

    Returns:
        The reading, with the box in stitched pixels.

    Raises:
        DecodeError: If a key is missing or unknown, or a value is not permitted.
    """
    key = box_key(value, convention, "box")
    part = decode.only_keys(value, (key, *(field.key for field in fields)), "the person")
    box = read_box(part[key], size, convention, key)
    labels: list[ReadLabel] = []
    ties: list[ReadTie] = []
    metres = None
    for field in fields:
        if field.kind == "metres":
            metres = _read_metres(part[field.key], field.key)
        elif field.kind == "relation":
            ties += _read_ties(part[field.key], field, index, numbers)
        elif (label := read_label(field, part[field.key])) is not None:
            labels.append(label)
    whole = box.x > 0 and box.x + box.w < size[0]
    return PersonReading(name, index, frame, from_crop(box, left), tuple(labels), tuple(ties), metres, whole)


def read_label(field: Field, value: object) -> ReadLabel | None:
    """Read the value of a field that is an attribute or a statement.

    Args:
        field: The field.
        value: The value in the reply.

    Returns:
        The label, or None for `CANNOT_TELL`.

    Raises:
        DecodeError: If the value is not permitted.
    """
    if field.kind == "words":
        text = free_value(value) if isinstance(value, str) else ""
        if not (0 < len(text) <= _LONGEST_WORDS and text.isprintable()):
            raise DecodeError(f"{field.key} must be a text of 1 to {_LONGEST_WORDS} printable characters")
        return None if text == CANNOT_TELL else ReadLabel(field.name, text)
    if value not in field.words:
        raise DecodeError(f"{field.key} must be one of {', '.join(field.words)}")
    if value == CANNOT_TELL:
        return None
    if field.kind == "labels":
        # Postures are actions.
        return ReadLabel("action" if field.name == "pose" else field.name, str(value))
    return ReadLabel(field.name, field.value, value == "yes")


def _read_metres(value: object, key: str) -> float | None:
    if value is None:
        return None
    metres = finite(value)
    if metres is None or not 0 <= metres <= 1000:
        raise DecodeError(f"{key} must be a number of metres, or null")
    return metres


def _read_ties(value: object, field: Field, index: int, numbers: Mapping[str, int]) -> Iterator[ReadTie]:
    """Yield for each other person of the call whether the relation leads to that person."""
    if value is None:
        return
    if not isinstance(value, list) or any(not isinstance(item, str) or item not in numbers for item in value):
        raise DecodeError(f"{field.key} must be a list of ids of people of the same call, or null")
    named = {numbers[item] for item in value}
    for partner in numbers.values():
        if partner != index:
            yield ReadTie(field.value, partner, partner in named)
