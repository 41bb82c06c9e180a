"""Records of what a model read of the people in one picture: labels of closed vocabularies with a confidence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from jrdb_avr.agent.perceive.geometry import angle_of
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.labels import ACTIONS, AGES, DISTANCE_WORDS, GENDERS, INTERACTIONS, POSES, ROBOT_SECTORS
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.relations import RELATIONS
from jrdb_avr.schema.things import OBJECTS, VERBS

USUAL: Final = 0.9
"""Confidence of a reading if the model states none."""

LEAST_SIDE: Final = 0.1
"""Pixels that a box must measure at least: sizes are compared by their ratios and areas, which smaller ones upset."""

_MOST_DIGITS: Final = 5
"""Of a number of people."""

_WORDS: Final[dict[str, frozenset[str]]] = {
    "gender": frozenset(GENDERS),
    "age": frozenset(AGES),
    "action": frozenset(ACTIONS),
    "distance": frozenset(DISTANCE_WORDS),
    "sector": frozenset(ROBOT_SECTORS),
    "interaction": frozenset(INTERACTIONS),
    "object": frozenset(f"{verb}: {thing}" for verb in VERBS for thing in OBJECTS),
}


def is_value(name: str, value: str) -> bool:
    """Whether an attribute may have a value: one of its labels, a number of people, or any text of a free attribute."""
    if name == "group_size":
        return value.isdecimal() and len(value) <= _MOST_DIGITS
    return value in _WORDS[name] if name in _WORDS else bool(value)


class ReadLabel(NamedTuple):
    """One attribute of a person as it was read: name and value as `Condition.wanted` writes them.

    holds: False where the reader says that it is not so; confidence: of the reader in this, from 0.5 to 1.
    """

    name: str
    value: str
    holds: bool = True
    confidence: float = USUAL

    @property
    def topic(self) -> str:
        """The question that the label answers."""
        return topic_of(self.name, self.value)


class ReadTie(NamedTuple):
    """A relation that was read: it leads from the person to another one of the same picture, given by number."""

    relation: str
    other: int
    holds: bool = True
    confidence: float = USUAL


@dataclass(frozen=True, slots=True)
class PersonReading:
    """One person in one picture, as a model read it.

    observation: the picture's name; number: of the person among those read in it; box: stitched pixels; whole: whether
    the picture shows the box from side to side; metres: the distance from the robot as read. Raises DecodeError for a
    label outside the vocabularies and for a box that is thinner than `LEAST_SIDE`.
    """

    observation: str
    number: int
    frame: int
    box: Box
    labels: tuple[ReadLabel, ...] = ()
    ties: tuple[ReadTie, ...] = ()
    metres: float | None = None
    whole: bool = True

    def __post_init__(self) -> None:
        if not (self.box.w >= LEAST_SIDE and self.box.h >= LEAST_SIDE):
            raise DecodeError("a box has a width and a height")
        for label in self.labels:
            if not is_value(label.name, label.value):
                raise DecodeError(f"{label.name} has no value {label.value!r}")
        for tie in self.ties:
            if tie.relation not in RELATIONS:
                raise DecodeError(f"there is no relation {tie.relation!r}")

    @property
    def angle(self) -> float:
        """Panorama angle of the middle of the box."""
        return angle_of(self.box)


def topic_of(name: str, value: str) -> str:
    """The question that an attribute with this value answers: "pose" for all postures, "gender", "action reading"."""
    if name == "action" and value in POSES:
        return "pose"
    return f"{name} {value}" if name in ("action", "object", "interaction") else name


def has_one_value(topic: str) -> bool:
    """Whether the values of a topic exclude each other."""
    return " " not in topic
