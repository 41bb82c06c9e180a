"""Tools of the graph: the arguments of each call, read or refused, and their JSON Schema.

The names and values of a write are the fields of the question, so that the graph holds only what the plan can use.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.conventions import Convention
from jrdb_avr.agent.model.decode import BOX_SCHEMA
from jrdb_avr.agent.perceive.fields import MOST_PEOPLE, SAME_PLACE, Field, read_label, read_person
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel
from jrdb_avr.agent.reference.chat_memory import OBSERVATION_SCHEMA
from jrdb_avr.agent.reference.turns import FINAL, WRITES, NamedView, call_schema, find_view, turn_schema
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import iou

GRAPH_TOOLS: Final = (*WRITES, "get_graph", FINAL)
"""The tools of an agent with a world model, beside `observe`."""

_LONGEST_ID: Final = 32
_NAME: Final = {"type": "string", "pattern": f"^[A-Za-z0-9_-]{{1,{_LONGEST_ID}}}$"}

People = list[tuple[str, PersonReading]]
"""Ids of people with what was read of each."""


def read_people(
    arguments: Mapping[str, Any],
    views: Mapping[str, NamedView],
    fields: Sequence[Field],
    counts: Mapping[str, int],
    convention: Convention,
) -> tuple[str, People, list[tuple[object, str]]]:
    """Read the call `add_people`.

    Args:
        arguments: The arguments of the call.
        views: All observations by name.
        fields: The fields of a person.
        counts: Number of people that were listed before, by observation.
        convention: How the model writes boxes.

    Returns:
        The name of the observation, the people, and each refused person with the reason.

    Raises:
        DecodeError: If the call names no observation, or has no list of at most `MOST_PEOPLE` people.
    """
    part = decode.only_keys(arguments, ("observation", "people"), "add_people")
    view, persons = find_view(part["observation"], views), part["people"]
    if not isinstance(persons, list) or len(persons) > MOST_PEOPLE:
        raise DecodeError(f'"people" must be a list of at most {MOST_PEOPLE} people')
    first = counts[view.name] + 1
    numbers: dict[str, int] = {}
    for number, person in enumerate(persons, first):
        if isinstance(person, dict) and _is_name(person.get("id")):
            # If an id comes twice, relations name the first person with the id.
            numbers.setdefault(person["id"], number)
    people: People = []
    faults: list[tuple[object, str]] = []
    for number, person in enumerate(persons, first):
        try:
            people.append(_read_person(person, number, numbers, view, fields, people, convention))
        except DecodeError as error:
            faults.append((person, f"people[{number - first}]: {error}"))
    return view.name, people, faults


def _read_person(
    person: object,
    number: int,
    numbers: Mapping[str, int],
    view: NamedView,
    fields: Sequence[Field],
    people: Sequence[tuple[str, PersonReading]],
    convention: Convention,
) -> tuple[str, PersonReading]:
    """Read a person of a list. `people` are the people of the list before."""
    if not isinstance(person, dict):
        raise DecodeError("a person must be an object")
    name = _name(person.get("id"), "id")
    if numbers[name] != number:
        raise DecodeError(f"{name} is in the list twice")
    value = {key: part for key, part in person.items() if key != "id"}
    reading = read_person(value, number, numbers, fields, *_origin(view), convention)
    for earlier, before in people:
        if iou(reading.box, before.box) >= SAME_PLACE:
            raise DecodeError(f"{name} has the box of {earlier}")
    return name, reading


def listed(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the call `add_entity` as a call `add_people` for a person without fields.

    Args:
        arguments: The arguments of the call.

    Returns:
        The arguments of `add_people`.
    """
    person = {key: value for key, value in arguments.items() if key != "observation"}
    return {"observation": arguments.get("observation"), "people": [person]}


def read_attribute(
    arguments: Mapping[str, Any], views: Mapping[str, NamedView], fields: Sequence[Field]
) -> tuple[str, str, ReadLabel]:
    """Read the call `add_attribute`.

    Args:
        arguments: The arguments of the call.
        views: All observations by name.
        fields: The fields of a person.

    Returns:
        The id of the entity, the name of the observation, and the label.

    Raises:
        DecodeError: If the call cannot be read, or its value says nothing.
    """
    part = decode.only_keys(arguments, ("entity", "observation", "name", "value"), "add_attribute")
    entity, view = _name(part["entity"], "entity"), find_view(part["observation"], views)
    label = read_label(_field(part["name"], _labelled(fields)), part["value"])
    if label is None:
        raise DecodeError("a value that cannot be told is not written")
    return entity, view.name, label


def read_relation(
    arguments: Mapping[str, Any], views: Mapping[str, NamedView], fields: Sequence[Field]
) -> tuple[str, str, str, str]:
    """Read the call `add_relation`.

    Args:
        arguments: The arguments of the call.
        views: All observations by name.
        fields: The fields of a person.

    Returns:
        The id of the source, the name of the observation, the relation, and the id of the target.

    Raises:
        DecodeError: If the call cannot be read.
    """
    part = decode.only_keys(arguments, ("source", "observation", "name", "target"), "add_relation")
    source, target = _name(part["source"], "source"), _name(part["target"], "target")
    view = find_view(part["observation"], views)
    field = _field(part["name"], [field for field in fields if field.kind == "relation"])
    if source == target:
        raise DecodeError("a relation joins two different people")
    return source, view.name, field.value, target


def _labelled(fields: Sequence[Field]) -> list[Field]:
    return [field for field in fields if field.kind not in ("metres", "relation")]


def _field(name: object, fields: Sequence[Field]) -> Field:
    field = next((field for field in fields if field.key == name), None)
    if field is None:
        keys = ", ".join(field.key for field in fields)
        raise DecodeError(f"name must be one of {keys}" if keys else "the question has no such field")
    return field


def _is_name(value: object) -> bool:
    if not isinstance(value, str) or not 0 < len(value) <= _LONGEST_ID:
        return False
    return value.isascii() and value.replace("_", "").replace("-", "").isalnum()


def _name(value: object, what: str) -> str:
    if not isinstance(value, str) or not _is_name(value):
        raise DecodeError(f"{what} must have 1 to {_LONGEST_ID} letters, digits, '_' or '-'")
    return value


def _origin(view: NamedView) -> tuple[str, int, int, tuple[int, int]]:
    """Return the name of an observation, its frame, its left column and its size."""
    return view.name, view.image.frames[0], view.image.left, view.image.size


# -- forms ------------------------------------------------------------------------------------------------------------


def world_schema(answer: Mapping[str, Any], fields: Sequence[Field], look: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the JSON Schema of a turn of an agent with a world model.

    Args:
        answer: The schema of an answer.
        fields: The fields of a person.
        look: The schema of a look, or None if no look can be made.

    Returns:
        The schema.
    """
    view = {"observation": OBSERVATION_SCHEMA}
    person = decode.closed_object({"id": _NAME, "box": BOX_SCHEMA, **{field.key: field.schema() for field in fields}})
    labels, relations = _labelled(fields), [field for field in fields if field.kind == "relation"]
    calls = [
        call_schema("add_people", {**view, "people": {"type": "array", "maxItems": MOST_PEOPLE, "items": person}}),
        call_schema("add_entity", {**view, "id": _NAME, "box": BOX_SCHEMA}),
        call_schema("add_attribute", {**view, "entity": _NAME, "name": _keys(labels), "value": {"type": "string"}}),
        *(
            [call_schema("add_relation", {**view, "source": _NAME, "name": _keys(relations), "target": _NAME})]
            if relations
            else []
        ),
        call_schema("get_graph", {}),
        call_schema(FINAL, {"answer": answer, "entity": _NAME}),
    ]
    return turn_schema([*([look] if look else []), *calls])


def _keys(fields: Sequence[Field]) -> dict[str, Any]:
    return {"type": "string", "enum": [field.key for field in fields]}
