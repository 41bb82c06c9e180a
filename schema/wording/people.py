"""Descriptions of people: conversion of conditions into a noun phrase, and the reverse conversion.

Left and right in a description are seen from the robot, and the phrase says so. A description has its conditions in
the order of `in_order`. This order differs from `Rules.condition_order`, which chooses among descriptions.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import msgspec

from jrdb_avr.schema.beliefs import TIMELESS
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import ACTION_PHRASES, INTERACTION_PHRASES
from jrdb_avr.schema.plan import Attribute, Condition
from jrdb_avr.schema.rules import CONDITION_KINDS
from jrdb_avr.schema.wording.phrases import FAR_AWAY, handled, handling, phrase_of

_HEADS: Final[dict[tuple[str | None, str | None], str]] = {
    (gender, age): head
    for age, heads in {
        None: ("person", "woman or girl", "man or boy"),
        "childhood": ("child", "girl", "boy"),
        "adolescence": ("teenager", "teenage girl", "teenage boy"),
        "young adulthood": ("young adult", "young woman", "young man"),
        "middle adulthood": ("middle-aged person", "middle-aged woman", "middle-aged man"),
        "late adulthood": ("elderly person", "elderly woman", "elderly man"),
    }.items()
    for gender, head in zip((None, "female", "male"), heads, strict=True)
}
"""Noun for each pair (gender, age)."""

_SECTORS: Final = {
    "ahead": "ahead of {robot}",
    "right": "to {robot's} right",
    "behind": "behind {robot}",
    "left": "to {robot's} left",
}
_DISTANCES: Final = {word: phrase.replace("{x}", "{robot}") for word, phrase in FAR_AWAY.items()}

_NUMBERS: Final = ("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
_SEEN: Final = " in the picture"
_ALONE: Final = "in no group" + _SEEN
_GROUP: Final = "in a group of "
_SIZE: Final = re.compile(rf"{_GROUP}({'|'.join(_NUMBERS)}|[1-9][0-9]{{0,5}}){_SEEN}")


def in_order(conditions: Sequence[Condition]) -> tuple[Condition, ...]:
    """Sort conditions as plans do: by kind (gender, age, pose, ...), then by their JSON.

    Args:
        conditions: Conditions of a person.
    """
    return tuple(sorted(conditions, key=lambda c: (CONDITION_KINDS.index(c.kind), msgspec.json.encode(c))))


def describe(conditions: Sequence[Condition]) -> str:
    """Return the noun phrase of conditions, such as "the only person to the robot's left who is sitting".

    Args:
        conditions: Conditions of a person.

    Raises:
        PlanError: If there is no phrase for the conditions.

    >>> describe((Condition(action="sitting", at="t0"), Condition(attribute="distance", value="far", at="t0")))
    'the only person far from the robot who is sitting'
    """
    values: dict[str, str | int] = {}
    doing = []
    for condition in conditions:
        if condition.attribute is not None and condition.value is not None:
            if condition.attribute in values:
                raise PlanError("conditions", f"{condition.attribute} is given twice")
            values[condition.attribute] = condition.value
        elif condition.action is not None:
            doing.append(phrase_of(ACTION_PHRASES, condition.action, "action"))
        elif condition.interaction is not None:
            doing.append(phrase_of(INTERACTION_PHRASES, condition.interaction, "interaction"))
        elif condition.object is not None and condition.verb is not None:
            doing.append(handling(condition.verb, condition.object))
    head = _HEADS.get((_text(values, "gender"), _text(values, "age")))
    if head is None:
        raise PlanError("conditions", f"there are no words for {values.get('gender')}, {values.get('age')}")
    position = _position(_text(values, "sector"), _text(values, "distance"))
    if "group_size" in values:
        doing.append(_group(values["group_size"]))
    clause = f"who is {_listed(doing)}" if doing else ""
    return " ".join(part for part in ("the only", head, position, clause) if part)


def _text(values: dict[str, str | int], name: str) -> str | None:
    value = values.get(name)
    return value if isinstance(value, str) else None


def _listed(parts: list[str]) -> str:
    return " and ".join((", ".join(parts[:-1]), parts[-1])) if len(parts) > 1 else parts[0]


def _group(size: str | int) -> str:
    if not isinstance(size, int) or size < 1:
        raise PlanError("conditions", f"{size!r} is no size of a group")
    if size == 1:
        return _ALONE
    return _GROUP + (_NUMBERS[size - 2] if size - 2 < len(_NUMBERS) else str(size)) + _SEEN


def _position(sector: str | None, distance: str | None) -> str:
    if (sector is not None and sector not in _SECTORS) or (distance is not None and distance not in _DISTANCES):
        raise PlanError("conditions", f"there are no words for the place {sector}, {distance}")
    first = _SECTORS[sector] if sector else ""
    second = _DISTANCES[distance] if distance else ""
    if first and second:
        second = second.replace("{robot}", "it")
    both = " and ".join(part for part in (first, second) if part)
    return both.replace("{robot}", "the robot").replace("{robot's}", "the robot's")


ACTION_OF: Final = {phrase: action for action, phrase in ACTION_PHRASES.items()}
_INTERACTION_OF: Final = {phrase: label for label, phrase in INTERACTION_PHRASES.items()}
_POSITIONS: Final = {
    _position(sector, distance): (sector, distance) for sector in (None, *_SECTORS) for distance in (None, *_DISTANCES)
}


def _alternatives(phrases: Sequence[str]) -> str:
    # Longer phrases come first, because a shorter phrase may be the beginning of a longer one.
    return "|".join(re.escape(phrase) for phrase in sorted(phrases, key=lambda phrase: (-len(phrase), phrase)))


_PERSON: Final = re.compile(
    rf"the only (?P<head>{_alternatives(list(_HEADS.values()))})"
    rf"(?: (?P<position>{_alternatives([position for position in _POSITIONS if position])}))?"
    r"(?: who is (?P<state>.+))?"
)


def read_description(text: str, at: str) -> tuple[Condition, ...]:
    """Read the conditions of a noun phrase.

    Args:
        text: Noun phrase.
        at: Name of the time of the conditions.

    Raises:
        PlanError: If the text is not a noun phrase of `describe`.
    """
    match = _PERSON.fullmatch(text)
    if match is None:
        raise PlanError("question", f"{text[:80]!r} describes nobody")
    gender, age = next(key for key, head in _HEADS.items() if head == match["head"])
    sector, distance = _POSITIONS[match["position"] or ""]
    values: dict[Attribute, str | None] = {"gender": gender, "age": age, "sector": sector, "distance": distance}
    conditions = [
        Condition(attribute=name, value=value, at=None if name in TIMELESS else at)
        for name, value in values.items()
        if value is not None
    ]
    if match["state"]:
        conditions += [_read_state(part, at) for part in re.split(", | and ", match["state"])]
    return in_order(conditions)


def _read_state(phrase: str, at: str) -> Condition:
    if phrase in ACTION_OF:
        return Condition(action=ACTION_OF[phrase], at=at)
    if phrase in _INTERACTION_OF:
        return Condition(interaction=_INTERACTION_OF[phrase], at=at)
    if phrase in handled():
        verb, thing = handled()[phrase]
        return Condition(object=thing, verb=verb, at=at)
    if phrase == _ALONE:
        return Condition(attribute="group_size", value=1, at=at)
    if match := _SIZE.fullmatch(phrase):
        size = _NUMBERS.index(match[1]) + 2 if match[1] in _NUMBERS else int(match[1])
        return Condition(attribute="group_size", value=size, at=at)
    raise PlanError("question", f"{phrase[:80]!r} is nothing a person is in a question")
