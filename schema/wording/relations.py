"""Relations between two people in words, and read back.

A hop is certain and single, so it introduces its target: as a sentence of two named people (`says`), or as the only
person who fits (`the`). Where several may fit, `holds` says what is true of the target, after "is". Left and right
always say whose they are: a person's own, or as seen from the robot. Nobody is ever "next to" anybody: the order of
angles says nothing about depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final, Literal

from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import (
    FIRST_LEFT,
    FIRST_RIGHT,
    INTERACTIONS,
    PERSON_SECTORS,
    SAME_GROUP,
    WINDOW_DEGREES,
    WINDOWS_LEFT,
    WINDOWS_RIGHT,
    person_frame_label,
)
from jrdb_avr.schema.wording.phrases import FAR_AWAY, TOGETHER

Style = Literal["says", "the", "holds"]
Use = Literal["hop", "join", "count"]
"""hop: single; join: one of the two relations that together single a person out; count: whose people are counted."""

_NEAR: Final = ("very close", "close", "moderate")
"""The distance words of person-frame relations that a question may use."""


@dataclass(frozen=True, slots=True)
class Words:
    """A relation's phrases about `{y}`, seen from `{x}`; an empty one where the relation is not used so.

    says: a sentence without its full stop; the: a noun phrase for y; holds: what y is.
    """

    says: str = ""
    the: str = ""
    holds: str = ""


def _social(label: str) -> Words:
    if label == "walking toward each other":
        towards = "walking towards {x} while {x} walks towards them"
        return Words(
            "{x} and exactly one other person, {y}, are walking towards each other",
            f"the only person {towards}",
            towards,
        )
    phrase = TOGETHER[label]
    holds = phrase.format(someone="{x}")
    return Words(
        "{x} is " + phrase.format(someone="exactly one person, {y}"),
        f"the only person who is {holds}",
        holds,
    )


def _person_frame(sector: str, word: str) -> Words:
    place = {"front": "in front of {x}", "back": "behind {x}"}.get(sector, f"to {{x}}'s {sector}")
    both = f"{FAR_AWAY[word]} and {place}"
    whose = "from {x}'s own point of view"
    return Words(
        f"{{y}} is the only person who is {both}, {whose}",
        f"the only person who is {both}, {whose}",
        f"{both} ({whose})",
    )


def _first(side: str) -> Words:
    first = f"the first person to the {side} of {{x}} as seen from the robot"
    return Words(f"{{y}} is {first}", first)


def _window(degrees: int, side: str) -> Words:
    return Words(holds=f"within {degrees} degrees to the {side} of {{x}} as seen from the robot")


RELATIONS: Final[dict[str, Words]] = {
    **{label: _social(label) for label in INTERACTIONS},
    SAME_GROUP: Words(
        "{x} and {y} are the only two members of their group",
        "the only other member of {x}'s group",
        "in the same group as {x}",
    ),
    **{person_frame_label(sector, word): _person_frame(sector, word) for sector in PERSON_SECTORS for word in _NEAR},
    FIRST_LEFT: _first("left"),
    FIRST_RIGHT: _first("right"),
    **{label: _window(n, "left") for label, n in zip(WINDOWS_LEFT, WINDOW_DEGREES, strict=True)},
    **{label: _window(n, "right") for label, n in zip(WINDOWS_RIGHT, WINDOW_DEGREES, strict=True)},
}
"""Every relation that a question may name."""

RELATIONS_OF: Final[dict[Use, tuple[str, ...]]] = {
    "hop": tuple(label for label, words in RELATIONS.items() if words.says),
    "join": tuple(label for label, words in RELATIONS.items() if words.holds),
    "count": (*INTERACTIONS, SAME_GROUP),
}


def relate(relation: str, use: Use, style: Style, x: str, y: str) -> str:
    """A relation's phrase with the people's names put in. Raises PlanError where there is none for this use."""
    if relation not in RELATIONS_OF[use]:
        raise PlanError("edges", f"there are no words for the relation {relation!r} as a {use}")
    phrase: str = getattr(RELATIONS[relation], style)
    return phrase.format(x=x, y=y)


@cache
def read_relations(use: Use, style: Style, x: str, y: str) -> dict[str, str]:
    """phrase -> relation, of all relations of this use."""
    return {relate(relation, use, style, x, y): relation for relation in RELATIONS_OF[use]}
