"""What an agent may write into its world model: the arguments of its tools, read or refused.

Arguments are whatever JSON a model wrote. They are checked for form and words here, and against the episode (what has
been observed and sighted) in `world_model`. Everything that passes is short, plain text or a finite number; what is
refused raises DecodeError with a reason that the model can act on.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Mapping
from typing import Any, Final

from jrdb_avr.agent.model.decode import finite, only_keys
from jrdb_avr.schema.beliefs import free_value
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.labels import (
    ACTIONS,
    AGES,
    DISTANCE_WORDS,
    GENDERS,
    INTERACTIONS,
    ROBOT_SECTORS,
    normal_action,
    normal_interaction,
    plain,
)
from jrdb_avr.schema.relations import RELATIONS
from jrdb_avr.schema.things import OBJECTS, VERBS, normal_category, normal_verb

LONGEST_TEXT: Final = 120
LONGEST_ARGUMENTS: Final = 4000
"""Characters of a call's arguments that the record holds."""

_ID: Final = re.compile(r"[A-Za-z0-9_-]{1,32}")
_NAME: Final = re.compile(r"[A-Za-z0-9_ ]{1,40}")


def read_entity(arguments: object) -> tuple[str, str, str, str]:
    """Read `add_entity` but for its box: id, kind, node ("" where there is none), observation. Raises DecodeError."""
    part = _part(arguments, ("id", "kind", "observation", "box"), ("node",))
    entity, kind = _id(part["id"], "id"), _kind(part["kind"])
    node = "" if part.get("node") is None else _text(part["node"], "node")
    return entity, kind, node, _text(part["observation"], "observation")


def read_attribute(arguments: object) -> tuple[str, str, str, float, str]:
    """Read `add_attribute`: entity, name, value as text, as number (0 where it is a text) and observation.

    Names and values that the solver knows come back in its spelling, others in lower case. Raises DecodeError.
    """
    part = _part(arguments, ("entity", "name", "value", "observation"))
    entity, name, value = _id(part["entity"], "entity"), _name(part["name"], "name"), part["value"]
    observation = _text(part["observation"], "observation")
    known, number = "_".join(name.lower().split()), 0.0
    if known in _WORDS:
        spell, words = _WORDS[known]
        text = spell(_text(value, "value"))
        if text not in words:
            raise DecodeError(f"{known} has no value {quoted(value)}; it is {_some(words)}")
    elif known == "object":
        text = _handled(_text(value, "value"))
    elif known in NUMBERS or isinstance(value, int | float):
        number = _number(value, *((known, *NUMBERS[known]) if known in NUMBERS else ("value",)))
        text = _digits(number)
    else:
        text = free_value(_text(value, "value"))
    return entity, known, text, number, observation


def read_relation(arguments: object) -> tuple[str, str, str, str]:
    """Read `add_relation`: source, name, target and observation; a name that the solver knows comes back in its
    spelling. Raises DecodeError.
    """
    part = _part(arguments, ("source", "name", "target", "observation"))
    source, target = _id(part["source"], "source"), _id(part["target"], "target")
    if source == target:
        raise DecodeError("a relation joins two different entities")
    name = _text(part["name"], "name")
    return source, _RELATIONS.get(plain(name)) or free_value(name), target, _text(part["observation"], "observation")


def as_json(arguments: object) -> str:
    """Arguments as JSON in ASCII, whatever they are; what cannot be written so, or is too long, is a text of it."""
    try:
        text = json.dumps(arguments, allow_nan=False)
    except (TypeError, ValueError, RecursionError):
        return json.dumps(f"unreadable {type(arguments).__name__}")
    return text if len(text) <= LONGEST_ARGUMENTS else json.dumps(text[: LONGEST_ARGUMENTS // 2] + "...")


def printable(text: str, most: int | None = None) -> str:
    """The first `most` characters of a text as a message can hold it: on one line, and with what UTF-8 cannot hold
    written out.
    """
    return " ".join(text[:most].split()).encode("utf-8", "backslashreplace").decode()


def quoted(value: object) -> str:
    """A model's word in a message of ours: short printable ASCII whatever it holds."""
    if not isinstance(value, str):
        return f"of type {type(value).__name__}"
    return repr(value[:40].encode("unicode_escape").decode())


# -- parts ------------------------------------------------------------------------------------------------------------


_WORDS: Final[dict[str, tuple[Callable[[str], str], tuple[str, ...]]]] = {
    "gender": (plain, GENDERS),
    "age": (plain, AGES),
    "action": (normal_action, ACTIONS),
    "sector": (plain, tuple(ROBOT_SECTORS)),
    "distance": (plain, DISTANCE_WORDS),
    "interaction": (normal_interaction, INTERACTIONS),
}
"""Attributes whose value is a label: how it is spelled, and all there are."""

NUMBERS: Final = {"group_size": (1.0, 1000.0, True), "distance_m": (0.0, 1000.0, False)}
"""Attributes whose value is a number: least, most, and whether it is a whole one."""

_RELATIONS: Final = {plain(label): label for label in (*VERBS, *RELATIONS)}


def _part(arguments: object, required: Collection[str], optional: Collection[str] = ()) -> Mapping[str, Any]:
    """The arguments as an object with these keys. Raises DecodeError naming the missing or extra ones."""
    keys = [*required, *(key for key in optional if isinstance(arguments, Mapping) and key in arguments)]
    return only_keys(arguments, keys, "the call")


def _id(value: object, what: str) -> str:
    if not (isinstance(value, str) and _ID.fullmatch(value)):
        raise DecodeError(f"{what} must be a name of 1 to 32 letters, digits, '_' and '-'")
    return value


def _name(value: object, what: str) -> str:
    name = " ".join(value.split()) if isinstance(value, str) and _NAME.fullmatch(value) else ""
    if not name:
        raise DecodeError(f"{what} must be 1 to 40 letters, digits, blanks and '_'")
    return name


def _kind(value: object) -> str:
    """The kind of an entity; a thing's in the vocabulary's spelling."""
    category = normal_category(value) if isinstance(value, str) else ""
    return category if category in OBJECTS else _name(value, "kind")


def _text(value: object, what: str) -> str:
    text = value.strip() if isinstance(value, str) and len(value) <= LONGEST_TEXT else ""
    if not text or not text.isprintable():
        raise DecodeError(f"{what} must be a text of 1 to {LONGEST_TEXT} printable characters")
    return text


def _number(value: object, what: str, least: float = -math.inf, most: float = math.inf, whole: bool = False) -> float:
    """A finite number in a range."""
    kind = "a whole number" if whole else "a number"
    number = finite(value)
    if number is None or not least <= number <= most or (whole and number % 1):
        within = f" from {least:g} to {most:g}" if math.isfinite(most) else ""
        raise DecodeError(f"{what} must be {kind}{within}")
    return number


def _digits(number: float) -> str:
    """The shortest text of a number, without a point where it is whole."""
    return str(int(number)) if number == int(number) and abs(number) < 1e15 else repr(number)


def _handled(value: str) -> str:
    """`<verb>: <category>` in the vocabulary's spelling."""
    verb, colon, category = value.partition(":")
    verb, category = normal_verb(verb), normal_category(category)
    if not colon or verb not in VERBS or category not in OBJECTS:
        raise DecodeError(f'object must be "verb: thing" in the labels\' words, as "holding: bag", not {quoted(value)}')
    return f"{verb}: {category}"


def _some(words: Collection[str]) -> str:
    listed = list(words)
    return ", ".join(listed[:12]) + (", ..." if len(listed) > 12 else "")
