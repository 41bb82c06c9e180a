"""Fields of a perception prompt: what the simulated model is to say of every person of a picture, and says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from jrdb_avr.agent.policy.explorer import Sighting
from jrdb_avr.agent.policy.finding import holds
from jrdb_avr.agent.policy.hops import related
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.relations import RELATIONS

START: Final = "Fields: "
"""Begins the prompt's line of fields: a JSON object of what each may hold."""

STAGE: Final = "The people in the picture, as one JSON object:"

SAME_STAGE: Final = "Which of them is the person, as one JSON object:"

NEAREST: Final = 10
"""The people of a reply."""

_UNKNOWN: Final = "cannot tell"
_WORDS: Final = {True: "yes", False: "no", None: _UNKNOWN}

Corners = tuple[int, int, int, int]
"""A box in thousandths of a picture."""

# Made at import: threads that meet a type first at the same time crash the decoder.
_FORMS: Final = msgspec.json.Decoder(dict[str, Any])


def read_fields(text: str) -> list[str]:
    """The names of the fields. Raises DecodeError for a line that cannot be read."""
    try:
        return [*_FORMS.decode(text)]
    except msgspec.DecodeError as error:
        raise DecodeError(f"the prompt's fields cannot be read: {error}") from None


def statement(name: str) -> Condition | None:
    """The statement about a person that a field makes; None where it makes none."""
    kind, _, value = name.partition(" ")
    if kind == "object":
        verb, _, thing = value.partition(": ")
        return Condition(object=thing, verb=verb, at="t0")
    if kind == "action":
        return Condition(action=value, at="t0")
    return Condition(interaction=value, at="t0") if kind == "interaction" else None


def said(name: str, person: Sighting, people: Sequence[Sighting]) -> Any:
    """What is said in a field of one of the people of a picture. Raises DecodeError for an unknown field."""
    mark = person.mark
    if (condition := statement(name)) is not None:
        if condition.interaction is not None and _joined(condition.interaction, person, people):
            return _WORDS[True]
        return _WORDS[holds(condition, person, people)]
    if name in ("gender", "age", "pose"):
        return getattr(mark, name) or _UNKNOWN
    if name.startswith("attribute "):
        # No mark holds it.
        return _UNKNOWN
    if name == "distance_m":
        return None if mark.distance_dm is None else mark.distance_dm / 10
    label = name.removeprefix("relation ")
    if label not in RELATIONS:
        raise DecodeError(f"the simulated model does not know the field {name[:60]!r}")
    if (RELATIONS[label].kind == "person" and mark.heading_deg is None) or not _readable(label, person):
        return None
    return _joined(label, person, people)


def _joined(label: str, person: Sighting, people: Sequence[Sighting]) -> list[int]:
    """Who of the picture has a relation to a person, by number."""
    return [n for n, one in enumerate(people, 1) if one is not person and related(label, person, one, people)]


def _readable(label: str, person: Sighting) -> bool:
    """Whether a person's mark says who has the relation to them."""
    return person.mark.group is not None if RELATIONS[label].kind == "group" else person.complete
