"""Eyes that cannot look: a fixed context of pictures, of which all is seen from the start.

A policy asks for a frame and gets the nearest one that was shown; that it is another frame is noted by the policy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from jrdb_avr.agent.policy.explorer import Eyes, Spent
from jrdb_avr.agent.simulated.requests import Look, Sighting
from jrdb_avr.schema.errors import DecodeError

_PLENTY: Final = 1000
"""Looks that a policy may plan with: looking at what was shown costs nothing."""


class Shown(Eyes):
    """The pictures of a request. Raises DecodeError where there are none."""

    def __init__(self, looks: Sequence[Look]) -> None:
        if not looks:
            raise DecodeError("the prompt shows no picture")
        super().__init__(sorted({look.frame for look in looks}), (), 0)
        self.looks = list(looks)

    def spare(self) -> int:
        return _PLENTY

    def look(self, frame: int, angle: float) -> Look:
        """The widest picture of the frame, whatever the angle."""
        return max((look for look in self.looks if look.frame == frame), key=lambda look: look.panorama)

    def again(self, frame: int, angle: float) -> Look:
        raise Spent

    def follow(self, identity: int, frame: float, turns: Sequence[float]) -> Sighting | None:
        """The person in the picture nearest to `frame`, if it is there."""
        shown = self.legal(frame)
        return next((seen for seen in self.at(shown) if seen.mark.identity == identity), None)
