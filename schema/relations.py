"""The relations between two people: one row each, with its kind. Every other module derives its lists from these rows.

A relation leads from a source to a target. Left and right of kinds "first" and "window" are the robot's; those of kind
"person" are the source's own.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS, INTERACTIONS, PERSON_SECTORS

RelationKind = Literal["social", "group", "first", "person", "window"]
Use = Literal["hop", "join", "count"]
"""hop: leads to one person; join: one of two relations that together lead to one person; count: the people who have it
are counted."""

LAYER_OF_KIND: Final[dict[RelationKind, str]] = {
    "social": "interactions",
    "group": "groups",
    "first": "2d",
    "person": "3d",
    "window": "2d",
}
"""The layer that tells whether a relation of the kind holds."""

KINDS_OF_USE: Final[dict[Use, tuple[RelationKind, ...]]] = {
    "hop": ("social", "group", "first", "person"),
    "join": ("social", "group", "person", "window"),
    "count": ("social", "group"),
}

SAME_GROUP: Final = "in the same group as"
WINDOW_DEGREES: Final = (30, 45, 60, 90)
PAIR_REACH_M: Final = 5.0
"""A question names relations of kind "person" only with distance words that begin below this distance."""


class Relation(NamedTuple):
    """A relation: its label, its kind, and the parts of the label.

    social: a labelled interaction, which holds both ways. group: both are members of one social group. first: the
    target is the first person on a `side` of the source. window: the target is within so many `degrees` on that side.
    person: the target stands in a `sector` of the source's own heading frame, at a `distance` (a distance word).
    """

    label: str
    kind: RelationKind
    side: Literal["left", "right", ""] = ""
    degrees: int = 0
    sector: str = ""
    distance: str = ""

    @property
    def in_questions(self) -> bool:
        """Whether a question may name it."""
        return self.kind != "person" or self.distance in _NEAR


_NEAR: Final = DISTANCE_WORDS[: 1 + sum(bound < PAIR_REACH_M for bound in DISTANCE_BOUNDS_M)]
_SIDES: Final[tuple[Literal["left", "right"], ...]] = ("left", "right")


def person_frame_label(sector: str, distance_word: str) -> str:
    """The label of a relation of kind "person", as in 'front left, close'."""
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
"""All relations by label, in the order in which questions are searched."""

QUESTION_RELATIONS: Final = tuple(row.label for row in _ROWS if row.in_questions)
"""Labels of the relations that a question may name."""

RELATIONS_OF: Final[dict[Use, tuple[str, ...]]] = {
    use: tuple(label for label in QUESTION_RELATIONS if RELATIONS[label].kind in kinds)
    for use, kinds in KINDS_OF_USE.items()
}
"""Labels of the relations that a question may name for each use."""

SYMMETRIC: Final = frozenset(row.label for row in _ROWS if row.kind in ("social", "group"))
"""Relations that hold both ways."""

FIRST_LEFT, FIRST_RIGHT = (row.label for row in _ROWS if row.kind == "first")
