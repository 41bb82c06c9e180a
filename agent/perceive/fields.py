"""Perception by the model: the people of one picture, each with a box, gender, age and the fields that a plan needs.

A request holds one picture and no question. What is closed, as gender or posture, is read from all its labels; what can
only be stated, as an action or a relation between people, stands among as many statements that the plan does not need,
so that a wish to please confirms nothing. What a reply denies is a reading too, what it cannot tell is none.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple

import msgspec

from jrdb_avr.agent.methods.attempt import Attempt
from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.conventions import Convention
from jrdb_avr.agent.model.decode import BOX_SCHEMA, box_key, finite, read_box
from jrdb_avr.agent.model.messages import Message, Part, metadata_line, picture_of
from jrdb_avr.agent.model.prompts import render
from jrdb_avr.agent.perceive.geometry import DERIVED
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie, topic_of
from jrdb_avr.queries.compiler.find import limits
from jrdb_avr.schema.beliefs import ALWAYS, free_value
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.labels import AGES, GENDERS, INTERACTIONS, OTHER_ACTIONS, POSES, answer_of_choice
from jrdb_avr.schema.method import Observation
from jrdb_avr.schema.panorama import CROP, from_crop, iou
from jrdb_avr.schema.plan import ATTRIBUTES, Condition, Edge, Node, Plan, Time, canonical
from jrdb_avr.schema.relations import QUESTION_RELATIONS, RELATIONS, SAME_GROUP
from jrdb_avr.schema.rules import FPS
from jrdb_avr.schema.things import OBJECTS, VERBS

MOST_PEOPLE: Final = 10
"""People of one reply."""

SAME_PLACE: Final = 0.95
"""IoU from which on two people of one reply have the same box."""

CANNOT_TELL: Final = "cannot tell"
_LONGEST_WORDS: Final = 40
"""Characters of a free attribute's value."""

_AWAY: Final = round(2 * FPS)
"""Frames between a stated frame and the one that is looked at for a moment before or after it."""

PEOPLE_LINE: Final = "The people in the picture, as one JSON object:"

_LABELS: Final = {"gender": GENDERS, "age": AGES, "pose": POSES}
_HANDLING: Final = ("carrying", "holding", "pushing", "touching")
_OTHERS: Final = {
    "action": OTHER_ACTIONS,
    "interaction": INTERACTIONS,
    "object": tuple(f"{verb}: {thing}" for verb in _HANDLING for thing in OBJECTS),
    "relation": tuple(label for label in QUESTION_RELATIONS if label not in DERIVED),
}
"""Statements that may stand beside those that a plan needs."""

_TAKEN: Final = frozenset({*ATTRIBUTES, *_LABELS, *_OTHERS})
"""Names of attributes that are never free."""


class Field(NamedTuple):
    """One thing to be read of every person: an attribute by its labels or in free words, a statement, metres, or a
    relation.
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
        """What a reply may say, where it is a word."""
        return (*(_LABELS[self.name] if self.kind == "labels" else ("yes", "no")), CANNOT_TELL)

    def form(self) -> Any:
        """The field as the prompt describes it."""
        forms = {"metres": "number", "relation": "people", "words": f'one or two words, or "{CANNOT_TELL}"'}
        return forms.get(self.kind) or self.words

    def schema(self) -> dict[str, Any]:
        """The JSON Schema of its value."""
        if self.kind == "metres":
            return {"type": ["number", "null"]}
        if self.kind == "relation":
            return {"type": ["array", "null"], "items": {"type": "integer"}, "maxItems": MOST_PEOPLE}
        if self.kind == "words":
            return {"type": "string", "minLength": 1, "maxLength": _LONGEST_WORDS}
        return {"type": "string", "enum": list(self.words)}


def perceivable(plan: Plan, changes: Mapping[str, int] = MappingProxyType({})) -> Plan:
    """Return a plan that pictures can be read for: of people alone, and at stated frames.

    A relation to a thing becomes a condition, and an attribute that is read of a thing becomes the person's. The
    identity of a thing, its place, and free relations with a name in `ATTRIBUTES` are left out. A moment becomes the
    frame two seconds from its limit, or in the middle of two. Facts at a group event hold at its frame.

    Args:
        plan: Plan.
        changes: Known frames of group events, by time. An unknown event is expected two seconds after its time `after`.
    """
    plan = _at_frames(plan, changes)
    things = plan.things
    if not things:
        return plan
    people = [node for node in plan.nodes if node.id not in things]
    joins = [edge for edge in plan.edges if edge.target in things and edge.relation not in RELATIONS]
    joins = [edge for edge in joins if edge.relation in VERBS or _free_name(edge) not in _TAKEN]
    nodes = tuple(
        Node(node.id, (*node.conditions, *(_of_thing(e, things[e.target]) for e in joins if e.source == node.id)))
        for node in people
    )
    answer, target = plan.answer, plan.target
    if answer.of in things:
        holder = next((e.source for e in plan.edges if e.target == answer.of), people[0].id)
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
    known = msgspec.structs.replace(plan, times=plan.times | frames)
    moments = {name: Time(frame=_frame(known, name)) for name, time in plan.times.items() if time.is_moment}
    times = plan.times | moments | {f"{name}_frame": time for name, time in frames.items()}
    if not events:
        return msgspec.structs.replace(plan, times=times)
    nodes = tuple(
        msgspec.structs.replace(
            node,
            conditions=tuple(
                msgspec.structs.replace(one, at=f"{one.at}_frame") if one.at in events else one
                for one in node.conditions
            ),
        )
        for node in plan.nodes
    )
    edges = tuple(
        msgspec.structs.replace(edge, at=f"{edge.at}_frame") if edge.at in events else edge for edge in plan.edges
    )
    return msgspec.structs.replace(plan, times=times, nodes=nodes, edges=edges)


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


def fields_of(plan: Plan, choices: Sequence[str] = ()) -> tuple[Field, ...]:
    """The fields that a plan needs, statements and relations among as many others, in an order that tells nothing.

    If an action is read, the offered actions are fields too, without others, as most of them are false. Where a plan
    needs most statements of a kind, there are fewer others.
    """
    needed = dict.fromkeys(_needed(plan))
    stated = [field for field in needed if field.value]
    for field in stated:
        rest = [one for value in _OTHERS[field.name] if (one := field._replace(value=value)) not in needed]
        needed |= dict.fromkeys(sorted(rest, key=lambda one: _shuffled(plan, one))[:1])
    needed |= dict.fromkeys(_offered(choices) if plan.answer.read == "action" else ())
    order = sorted((field for field in needed if field.value), key=lambda one: _shuffled(plan, one))
    return (*(field for field in needed if not field.value), *order)


def _needed(plan: Plan) -> Iterator[Field]:
    answer = plan.answer
    # By these people are known again, whatever the plan says of them.
    yield Field("labels", "gender")
    yield Field("labels", "age")
    wanted = [condition.wanted for node in plan.nodes for condition in node.conditions]
    wanted += [] if answer.attribute is None else [(answer.attribute, "")]
    wanted += [("group_size", "") for time in plan.times.values() if time.is_group_event]
    wanted += [("action", time.action) for time in plan.times.values() if time.action is not None]
    for name, value in wanted:
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


# -- a request --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Perceiver:
    """Reads pictures for one plan."""

    attempt: Attempt
    fields: Sequence[Field]

    def people(self, seen: Observation, name: str) -> tuple[PersonReading, ...] | None:
        """The people read in a picture; None where neither of two replies could be read."""
        sound: tuple[PersonReading, ...] | None = None
        system = Message("system", (perceive_prompt(self.fields),))
        before: tuple[Part, ...] = (field_line(self.fields), f"Picture: {metadata_line(seen)}", picture_of(seen))

        def read(reply: Mapping[str, Any]) -> tuple[PersonReading, ...]:
            nonlocal sound
            people = read_people(reply, self.fields, seen, name, self.attempt.convention)
            twice = [(one, other) for one, other in itertools.combinations(people, 2) if _alike(one, other)]
            if not twice:
                return people
            # Which of two people has the box of the other cannot be told.
            doubtful = {one.number for pair in twice for one in pair}
            sound = tuple(_without(one, doubtful) for one in people if one.number not in doubtful)
            raise DecodeError("; ".join(f"{one.number} and {other.number} have the same box" for one, other in twice))

        try:
            return self.attempt.ask_twice(
                lambda faults: [system, Message("user", (*before, *faults, PEOPLE_LINE))],
                perceive_schema(self.fields),
                read,
            )
        except DecodeError:
            return sound


def perceive_prompt(fields: Sequence[Field]) -> str:
    """The system message of a request for these fields."""
    return render("agent_perceive", most=MOST_PEOPLE, example="".join(f', "{field.key}": ...' for field in fields))


def field_line(fields: Sequence[Field]) -> str:
    """The line that says what each field may hold."""
    return f"Fields: {json.dumps({field.key: field.form() for field in fields})}"


def perceive_schema(fields: Sequence[Field]) -> dict[str, Any]:
    """The JSON Schema of a reply with these fields."""
    person = decode.closed_object({"box": BOX_SCHEMA, **{field.key: field.schema() for field in fields}})
    return decode.closed_object({"people": {"type": "array", "maxItems": MOST_PEOPLE, "items": person}})


def _alike(one: PersonReading, other: PersonReading) -> bool:
    return iou(one.box, other.box) >= SAME_PLACE


def _without(one: PersonReading, others: Collection[int]) -> PersonReading:
    """The reading without its relations to some of the others."""
    return replace(one, ties=tuple(tie for tie in one.ties if tie.other not in others))


# -- a reply ----------------------------------------------------------------------------------------------------------


def read_people(
    reply: Mapping[str, Any], fields: Sequence[Field], seen: Observation, name: str, convention: Convention
) -> tuple[PersonReading, ...]:
    """The people of a reply about an observation of this name. Raises DecodeError."""
    people = decode.only_keys(reply, ("people",), "the reply")["people"]
    if not isinstance(people, list) or len(people) > MOST_PEOPLE:
        raise DecodeError(f'"people" must be a list of at most {MOST_PEOPLE} people')
    return tuple(
        _read_person(one, number, len(people), fields, seen, name, convention) for number, one in enumerate(people, 1)
    )


def _read_person(
    value: object,
    number: int,
    count: int,
    fields: Sequence[Field],
    seen: Observation,
    name: str,
    convention: Convention,
) -> PersonReading:
    key = box_key(value, convention, "box")
    part = decode.only_keys(value, (key, *(field.key for field in fields)), f"people[{number - 1}]")
    box = read_box(part[key], (CROP, CROP), convention, key)
    labels: list[ReadLabel] = []
    ties: list[ReadTie] = []
    metres = None
    for field in fields:
        said = part[field.key]
        if field.kind == "metres":
            metres = None if said is None else _metres(said, field.key)
        elif field.kind == "relation":
            ties += _ties(said, field, number, count)
        elif field.kind == "words":
            text = free_value(said) if isinstance(said, str) else ""
            if not (0 < len(text) <= _LONGEST_WORDS and text.isprintable()):
                raise DecodeError(f"{field.key} must be a text of 1 to {_LONGEST_WORDS} printable characters")
            labels += [] if text == CANNOT_TELL else [ReadLabel(field.name, text)]
        elif said not in field.words:
            raise DecodeError(f"{field.key} must be one of {', '.join(field.words)}")
        elif said != CANNOT_TELL:
            # Postures are actions.
            closed = ReadLabel("action" if field.name == "pose" else field.name, said)
            labels.append(closed if field.kind == "labels" else ReadLabel(field.name, field.value, said == "yes"))
    whole = box.x > 0 and box.x + box.w < CROP
    place = from_crop(box, seen.left)
    return PersonReading(name, number, seen.frame_index, place, tuple(labels), tuple(ties), metres, whole)


def _metres(value: object, key: str) -> float:
    metres = finite(value)
    if metres is None or not 0 <= metres <= 1000:
        raise DecodeError(f"{key} must be a number of metres, or null")
    return metres


def _ties(value: object, field: Field, number: int, count: int) -> Iterator[ReadTie]:
    """Of each other person of the picture, whether the relation leads to them."""
    if value is None:
        return
    if not isinstance(value, list) or any(type(one) is not int for one in value):
        raise DecodeError(f"{field.key} must be a list of numbers of people, or null")
    for other in range(1, count + 1):
        if other != number:
            yield ReadTie(field.value, other, other in value)
