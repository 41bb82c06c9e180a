"""People as the annotations describe them at one frame, and as the simulated model reads them in one picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from jrdb_avr.schema.panorama import Box


@dataclass(frozen=True)
class Person:
    """A person at one frame, with all that the annotations say.

    Attributes:
        track: Id of the person in the sequence. False people have negative ids.
        box: Box in stitched pixels.
        labels: Values by name: gender, age, pose, action, interaction and object. An unknown name is missing.
        ties: Tracks of partners by relation. An unknown relation is missing.
        metres: Distance from the robot, or None if it is unknown.
    """

    track: int
    box: Box
    labels: Mapping[str, frozenset[str]] = field(default_factory=dict)
    ties: Mapping[str, frozenset[int]] = field(default_factory=dict)
    metres: float | None = None
