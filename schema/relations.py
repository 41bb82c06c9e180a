"""Relations between two people. Each relation is one row, and other modules derive their lists from these rows.

A relation leads from a source to a target. In relations of the kinds "first" and "window", left and right are seen from
the robot. In relations of the kind "person", they are seen from the source.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS, INTERACTIONS, PERSON_SECTORS

RelationKind = Literal["social", "group", "first", "person", "window"]
Use = Literal["hop", "join", "count"]
"""Use of a relation in a question.

hop: the relation leads to one person. join: two relations together lead to one person. count: the question counts the
people who have the relation.
"""

KINDS_OF_USE: Final[dict[Use, tuple[RelationKind, ...]]] = {
    "hop": ("social", "group", "first", "person"),
    "join": ("social", "group", "person", "window"),
    "count": ("social", "group"),
}

SAME_GROUP: Final = "in the same group as"
WINDOW_DEGREES: Final = (30, 45, 60, 90)
PAIR_REACH_M: Final = 5.0
"""Distance in metres. A question uses a relation of the kind "person" only if its distance word begins below it."""


class Relation(NamedTuple):
    """A relation: its label, its kind, and the parts of the label.

    Attributes:
        label: Name of the relation.
        kind: social: a labelled interaction, which holds in both directions. group: both people are members of one
            social group. first: the target is the first person on a side of the source. window: the target is within
            some degrees on a side. person: the target is in a sector of the source, at a distance.
        side: Side of the kinds "first" and "window", otherwise "".
        degrees: Maximum angle of the kind "window", otherwise 0.
        sector: Sector of the kind "person", otherwise "".
        distance: Distance word of the kind "person", otherwise "".
    """

    label: str
    kind: RelationKind
    side: Literal["left", "right", ""] = ""
    degrees: int = 0
    sector: str = ""
    distance: str = ""

    @property
    def in_questions(self) -> bool:
        """Whether a question may have the relation."""
        return self.kind != "person" or self.distance in _NEAR


_NEAR: Final = DISTANCE_WORDS[: 1 + sum(bound < PAIR_REACH_M for bound in DISTANCE_BOUNDS_M)]
_SIDES: Final[tuple[Literal["left", "right"], ...]] = ("left", "right")


def person_frame_label(sector: str, distance_word: str) -> str:
    """Return the label of a relation of the kind "person", such as 'front left, close'.

    Args:
        sector: Sector of the source.
        distance_word: Distance word.
    """
    return f"{sector}, {distance_word}"


_ROWS: Final = (
    *(Relation(label, "social") for label in INTERACTIONS),
    Relation(SAME_GROUP, "group"),
    *(Relation(f"first to the {side} of (robot view)", "first", side) for side in _SIDES),
    *(
        Relation(person_frame_label(sector, word), "person", sector=sector, distance=word)
        for sector in PERSON_SECTORS
        for word in DISTANCE_WORDS
    ),
    *(
        Relation(f"within {degrees} degrees to the {side} of (robot view)", "window", side, degrees)
        for side in _SIDES
        for degrees in WINDOW_DEGREES
    ),
)

RELATIONS: Final[dict[str, Relation]] = {row.label: row for row in _ROWS}
"""All relations by label, in the order of the search for questions."""

QUESTION_RELATIONS: Final = tuple(row.label for row in _ROWS if row.in_questions)
"""Labels of the relations that a question may have."""

RELATIONS_OF: Final[dict[Use, tuple[str, ...]]] = {
    use: tuple(label for label in QUESTION_RELATIONS if RELATIONS[label].kind in kinds)
    for use, kinds in KINDS_OF_USE.items()
}
"""Labels of the relations that a question may have, by use."""

SYMMETRIC: Final = frozenset(row.label for row in _ROWS if row.kind in ("social", "group"))
"""Labels of the relations that hold in both directions."""

FIRST_LEFT, FIRST_RIGHT = (row.label for row in _ROWS if row.kind == "first")
