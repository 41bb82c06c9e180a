"""Eyes over looks of which most are known from the reference agent's graph alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from jrdb_avr.agent.policy.explorer import AROUND, Eyes, Want, same
from jrdb_avr.agent.simulated.requests import Look, Sighting

_EIGHT: Final = (0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)
"""Turns that just go once round, for absences at several times, where nine looks each may be too many."""


class Round(Exception):  # noqa: N818
    """Looks to make in one turn, all at one frame."""

    def __init__(self, frame: int, angles: Sequence[float]) -> None:
        super().__init__(f"frame {frame}, {len(angles)} angles")
        self.frame = frame
        self.angles = angles


class Memory(Eyes):
    """Eyes that know the first `known` looks from the start, and need no look to show somebody again.

    `rounds` are the frames that may still have to be looked at all round.
    """

    def __init__(
        self, frames: Sequence[int], looks: Sequence[Look], left: int, known: int = 0, rounds: int = 1
    ) -> None:
        super().__init__(frames, looks[known:], left)
        self.looks = list(looks[:known])
        self._rounds = rounds

    def spare(self) -> int:
        """Looks left at this point."""
        return self._left + len(self._ahead)

    def follow(self, identity: int, frame: float, turns: Sequence[float]) -> Sighting | None:
        """As `Eyes.follow`; once round in eight looks where the frames still to come leave no more.

        The looks that were made at the frame are those of the first turns: boxes in the graph are rounded, or cut off
        by a picture's edge, so they do not say again at which angles it was looked.
        """
        if turns == AROUND:
            others = max(self._rounds - 1, 0)
            self._rounds = others
            turns = _EIGHT if self.spare() < len(AROUND) + len(_EIGHT) * others else AROUND
        frame = self.legal(frame)
        known = min(self.sightings(identity), key=lambda seen: (abs(seen.frame - frame), seen.frame))
        if known.frame == frame:
            return known
        made = [look for look in (*self.looks, *self._ahead) if look.frame == frame]
        first = made[0].angle if made else known.angle
        for place, turn in enumerate(turns):
            look = self._recall(made[place]) if place < len(made) else self.look(frame, first + turn)
            if (seen := look.of(identity)) is not None:
                return seen
        return None

    def _recall(self, look: Look) -> Look:
        while self._ahead and not any(look is other for other in self.looks):
            self.looks.append(self._ahead.pop(0))
        return look

    def _next(self, frame: int, angle: float) -> Look:
        # What was written anew may show somebody a look earlier than it did then: looks may be left over.
        for look in self._ahead:
            if look.frame == frame and same(look.angle, angle):
                return self._recall(look)
        raise Want(frame, angle % 360.0)
