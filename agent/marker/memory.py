"""Eyes over looks of which most are known from the reference agent's graph alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from .eyes import AROUND, Eyes, Want, same
from .reading import Look, Sighting

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
        """As `Eyes.follow`; once round in eight looks where the frames still to come leave no more."""
        if turns == AROUND:
            others = max(self._rounds - 1, 0)
            self._rounds = others
            turns = _EIGHT if self.spare() < len(AROUND) + len(_EIGHT) * others else AROUND
        return super().follow(identity, frame, turns)

    def _next(self, frame: int, angle: float) -> Look:
        # What was written anew may show somebody a look earlier than it did then: looks may be left over.
        while self._ahead:
            look = self._ahead.pop(0)
            self.looks.append(look)
            if look.frame == frame and same(look.angle, angle):
                return look
        raise Want(frame, angle % 360.0)
