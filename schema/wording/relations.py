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
from jrdb_avr.schema.labels import JOINT_PHRASES
from jrdb_avr.schema.relations import QUESTION_RELATIONS, RELATIONS, RELATIONS_OF, Relation, Use
from jrdb_avr.schema.wording.phrases import FAR_AWAY

Style = Literal["says", "the", "holds"]


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
    phrase = JOINT_PHRASES[label]
    holds = phrase.format(someone="{x}")
    return Words("{x} is " + phrase.format(someone="exactly one person, {y}"), f"the only person who is {holds}", holds)


def _words(relation: Relation) -> Words:
    side = f"to the {relation.side} of {{x}} as seen from the robot"
    match relation.kind:
        case "social":
            return _social(relation.label)
        case "group":
            return Words(
                "{x} and {y} are the only two members of their group in the picture",
                "the only other member of {x}'s group in the picture",
                "in the same group as {x}",
            )
        case "first":
            return Words(f"{{y}} is the first person {side}", f"the first person {side}")
        case "window":
            return Words(holds=f"within {relation.degrees} degrees {side}")
        case "person":
            places = {"front": "in front of {x}", "back": "behind {x}"}
            place = places.get(relation.sector, f"to {{x}}'s {relation.sector}")
            both = f"{FAR_AWAY[relation.distance]} and {place}"
            whose = "from {x}'s own point of view"
            return Words(
                f"{{y}} is the only person who is {both}, {whose}",
                f"the only person who is {both}, {whose}",
                f"{both} ({whose})",
            )


_WORDS: Final = {label: _words(RELATIONS[label]) for label in QUESTION_RELATIONS}


def relate(relation: str, use: Use, style: Style, x: str, y: str) -> str:
    """A relation's phrase for two named people. Raises PlanError where there is none for this use."""
    if relation not in RELATIONS_OF[use]:
        raise PlanError("edges", f"there are no words for the relation {relation!r} as a {use}")
    phrase: str = getattr(_WORDS[relation], style)
    return phrase.format(x=x, y=y)


@cache
def read_relations(use: Use, style: Style, x: str, y: str) -> dict[str, str]:
    """phrase -> relation, for all relations of this use."""
    return {relate(relation, use, style, x, y): relation for relation in RELATIONS_OF[use]}
