"""Weights of repeated readings: how much a second reading of the same person tells."""

from __future__ import annotations

from typing import Annotated, Final

import msgspec
from msgspec import Meta

Weight = Annotated[float, Meta(ge=0.0, le=1.0)]


class Repeats(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Weights of repeated readings of a person, in readings, because the errors of a model repeat.

    Attributes:
        frame: Weight of a further reading in the same frame.
        person: Weight of the readings of a frame other than the nearest one.
    """

    frame: Weight = 0.05
    person: Weight = 0.25


USUAL_REPEATS: Final = Repeats()
"""Weights if no calibration of the model is known."""
