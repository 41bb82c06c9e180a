"""Fields of a prompt: what the simulated model replies about each person of a picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.simulated.noise import ReadPerson
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.relations import RELATIONS

START: Final = "Fields: "
"""Beginning of the prompt's line of fields: a JSON object of what each field may hold."""

NEAREST: Final = 10
"""Maximum number of people in a reply."""

_UNKNOWN: Final = "cannot tell"
_WORDS: Final = {True: "yes", False: "no", None: _UNKNOWN}

# Made at import, because threads that meet a type first at the same time crash the decoder.
_FORMS: Final = msgspec.json.Decoder(dict[str, Any])


def read_fields(text: str) -> list[str]:
    """Return the keys of the fields in a prompt's line. Raise DecodeError if the line cannot be read."""
    try:
        return [*_FORMS.decode(text)]
    except msgspec.DecodeError as error:
        raise DecodeError(f"the prompt's fields cannot be read: {error}") from None


def say(key: str, person: ReadPerson, people: Sequence[ReadPerson]) -> Any:
    """Return what the model replies in a field.

    Args:
        key: Key of the field, such as "gender", "action reading" or "relation hugging".
        person: The described person.
        people: All people of the reply, in its order.

    Returns:
        The value. For a relation, the positions of the partners, from 1, or None if the model cannot tell.

    Raises:
        DecodeError: If the model does not know the field.
    """
    name, _, value = key.partition(" ")
    match name:
        case "gender" | "age" | "pose" if not value:
            return person.label(name) or _UNKNOWN
        case "distance_m":
            return person.metres
        case "action" | "interaction" | "object":
            return _WORDS[person.holds(name, value)]
        case "attribute":
            # No annotation holds it.
            return _UNKNOWN
        case "relation" if value in RELATIONS:
            return person.partners(value, people)
    raise DecodeError(f"the simulated model does not know the field {key[:60]!r}")


def describe(people: Sequence[ReadPerson], keys: Iterable[str], size: tuple[int, int]) -> dict[str, dict[str, Any]]:
    """Return what the model replies about the people of a picture, by id.

    Args:
        people: People of the reply.
        keys: Keys of the fields.
        size: Width and height of the picture in pixels.

    Returns:
        The box and the fields of each person. Relations name ids.
    """
    ids, keys = [f"p{person.identity}" for person in people], tuple(keys)
    found = {}
    for entity, person in zip(ids, people, strict=True):
        said = {key: say(key, person, people) for key in keys}
        named = {key: [ids[n - 1] for n in value] if isinstance(value, list) else value for key, value in said.items()}
        found[entity] = {"box": write_box(person.box, size), **named}
    return found
