"""Phrases for relations between two people, and the reverse conversion.

A hop leads to exactly one person. Its phrase is a sentence about both people (`says`), or a noun phrase for the target
(`the`). If several people may have the relation, the phrase is a predicate of the target (`holds`), which follows "is".
A phrase with left or right always names the point of view. No phrase says "next to", because people at neighbouring
angles can be at very different distances.
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
    """Phrases of a relation.

    `{x}` is the source, and `{y}` is the target. A phrase is empty if it is not used.

    Attributes:
        says: Sentence without a full stop.
        the: Noun phrase for the target.
        holds: Predicate of the target.
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
            front_and_back = {"front": "in front of {x}", "back": "behind {x}"}
            direction = front_and_back.get(relation.sector, f"to {{x}}'s {relation.sector}")
            both = f"{FAR_AWAY[relation.distance]} and {direction}"
            view = "from {x}'s own point of view"
            return Words(
                f"{{y}} is the only person who is {both}, {view}",
                f"the only person who is {both}, {view}",
                f"{both} ({view})",
            )


_WORDS: Final = {label: _words(RELATIONS[label]) for label in QUESTION_RELATIONS}


def relate(relation: str, use: Use, style: Style, x: str, y: str) -> str:
    """Return the phrase of a relation between two named people.

    Args:
        relation: Label of the relation.
        use: Use of the relation.
        style: Form of the phrase.
        x: Name of the source.
        y: Name of the target.

    Raises:
        PlanError: If the relation has no phrase for the use.
    """
    if relation not in RELATIONS_OF[use]:
        raise PlanError("edges", f"there are no words for the relation {relation!r} as a {use}")
    phrase: str = getattr(_WORDS[relation], style)
    return phrase.format(x=x, y=y)


@cache
def read_relations(use: Use, style: Style, x: str, y: str) -> dict[str, str]:
    """Return the relation by its phrase, for all relations of a use.

    Args:
        use: Use of the relations.
        style: Form of the phrases.
        x: Name of the source.
        y: Name of the target.
    """
    return {relate(relation, use, style, x, y): relation for relation in RELATIONS_OF[use]}
