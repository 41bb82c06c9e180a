"""Looking: what has been seen, and the wish to see more.

A policy is written as if looking were a function call. A look that the history holds is returned; the first one that
it does not hold is raised as `Want`, which ends the turn: on the next turn the policy runs again from the start and
gets one look further. For this a policy must be a pure function of its request, and a step of it must know only the
looks of the steps before it: `Eyes` uncovers the history look by look, as the policy asks for them.
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from typing import Final

from jrdb_avr.agent.simulated.requests import Look, Sighting
from jrdb_avr.schema.panorama import angle_error

AROUND: Final = (0.0, 40.0, -40.0, 80.0, -80.0, 120.0, -120.0, 160.0, -160.0)
"""Turns from a first direction that go once round, the nearest first.

One more than eight looks: neighbours share 62 columns, more than any plate is wide, so each is whole in one of them.
"""

NEARBY: Final = AROUND[:3]

_SAME_DEG: Final = 1.0


class Want(Exception):  # noqa: N818
    """The next look to make."""

    def __init__(self, frame: int, angle: float) -> None:
        super().__init__(f"frame {frame}, angle {angle}")
        self.frame = frame
        self.angle = angle


class Spent(Exception):  # noqa: N818
    """No look is left but the one kept for showing the evidence."""


class Eyes:
    """The looks of a question, uncovered in the order in which they were made.

    `frames` are the legal ones, ascending; `left` is how many looks may still be made after these.
    """

    def __init__(self, frames: Sequence[int], looks: Sequence[Look], left: int) -> None:
        self.frames = frames
        self.looks: list[Look] = []
        self._ahead = list(looks)
        self._left = left

    def spare(self) -> int:
        """Looks left at this point beside the one that is kept for the evidence."""
        return max(self._left + len(self._ahead) - 1, 0)

    def legal(self, frame: float) -> int:
        """The legal frame nearest to a frame."""
        place = bisect.bisect_left(self.frames, frame)
        near = self.frames[max(place - 1, 0) : place + 1]
        return min(near, key=lambda f: abs(f - frame))

    def look(self, frame: int, angle: float) -> Look:
        """The look at a legal frame. Raises Want if it is the next to make, Spent when only one look is left."""
        for look in self.looks:
            if look.frame == frame and same(look.angle, angle):
                return look
        if self.spare() == 0:
            raise Spent
        return self._next(frame, angle)

    def again(self, frame: int, angle: float) -> Look:
        """A new look as near to `angle` as the looks before it allow; takes the last look too."""
        before = [look.angle for look in self.looks if look.frame == frame]
        offset = 0.0
        while any(same(other, angle + offset) for other in before):
            offset = -offset if offset > 0 else 1.5 - offset
        if self._left + len(self._ahead) == 0:
            raise Spent
        return self._next(frame, angle + offset)

    def _next(self, frame: int, angle: float) -> Look:
        if self._ahead and self._ahead[0].frame == frame and same(self._ahead[0].angle, angle):
            self.looks.append(self._ahead.pop(0))
            return self.looks[-1]
        raise Want(frame, angle % 360.0)

    def sightings(self, identity: int) -> list[Sighting]:
        """Every sighting of a person so far, the newest look first."""
        found = (look.of(identity) for look in reversed(self.looks))
        return [seen for seen in found if seen is not None]

    def at(self, frame: int) -> list[Sighting]:
        """Everybody seen at a frame, each once: of several sightings the one that shows the box whole."""
        best: dict[int, Sighting] = {}
        for look in self.looks:
            for seen in look.sightings if look.frame == frame else ():
                held = best.get(seen.mark.identity)
                if held is None or (seen.whole, seen.complete) > (held.whole, held.complete):
                    best[seen.mark.identity] = seen
        return [best[identity] for identity in sorted(best)]

    def follow(self, identity: int, frame: float, turns: Sequence[float]) -> Sighting | None:
        """A person seen before, at the legal frame nearest to `frame`.

        Looked for at these turns from where it was seen at the nearest other frame; None if none of them shows it.
        """
        frame = self.legal(frame)
        known = min(self.sightings(identity), key=lambda seen: (abs(seen.frame - frame), seen.frame))
        if known.frame == frame:
            return known
        for turn in turns:
            found = self.look(frame, known.angle + turn).of(identity)
            if found is not None:
                return found
        return None


def same(a: float, b: float) -> bool:
    """Whether a look at one angle would be refused as too near to a look at the other."""
    """Whether two angles in degrees are so near that the second look would be a duplicate."""
    return float(angle_error(a % 360.0, b % 360.0)) <= _SAME_DEG
