"""Records of what a model read of the people in one picture: labels, relations, boxes and distances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from jrdb_avr.agent.perceive.geometry import angle_of
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.panorama import Box

CONFIDENCE: Final = 0.9
"""Confidence of each reading, because models state none."""

LEAST_SIDE: Final = 0.1
"""Minimum width and height of a box in pixels."""


class ReadLabel(NamedTuple):
    """One attribute of a person as it was read, with name and value as `Condition.wanted` writes them.

    Attributes:
        name: Name of the attribute.
        value: Value of the attribute.
        holds: False if the reader denies the value.
    """

    name: str
    value: str
    holds: bool = True

    @property
    def topic(self) -> str:
        """The question that the label answers."""
        return topic_of(self.name, self.value)


class ReadTie(NamedTuple):
    """A relation from a person to another person of the same picture, as it was read.

    Attributes:
        relation: Name of the relation.
        other: Number of the other person in the picture.
        holds: False if the reader denies the relation.
    """

    relation: str
    other: int
    holds: bool = True


@dataclass(frozen=True, slots=True)
class PersonReading:
    """One person in one picture, as a model read it.

    DecodeError is raised for a box that is smaller than `LEAST_SIDE`.

    Attributes:
        observation: Name of the picture.
        number: Number of the person in the picture.
        frame: Frame of the picture.
        box: Box in stitched pixels.
        labels: Attributes.
        ties: Relations to other people of the picture.
        metres: Distance from the robot in metres, None if it was not read.
        whole: Whether no edge of the picture cuts the box.
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
        """Check the box."""
        if not (self.box.w >= LEAST_SIDE and self.box.h >= LEAST_SIDE):
            raise DecodeError("a box has a width and a height")

    @property
    def angle(self) -> float:
        """Panorama angle of the middle of the box in degrees."""
        return angle_of(self.box)


def topic_of(name: str, value: str) -> str:
    """Return the question that an attribute answers: "pose" for all postures, "gender", "action reading"."""
    if name == "action" and value in POSES:
        return "pose"
    return f"{name} {value}" if name in ("action", "object", "interaction") else name


def has_one_value(topic: str) -> bool:
    """Return whether the values of a topic exclude each other."""
    return " " not in topic
