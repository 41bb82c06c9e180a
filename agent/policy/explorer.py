"""Exploration state: which looks have been made, what was seen in them, and which look to make next.

A policy is written as if looking were a function call. A look of the history is returned; the first one that the
history lacks raises `NeedObservation`, which ends the turn: on the next turn the policy runs again from the start and
gets one look further. So a policy must be a pure function of its request, and each of its steps may know only the looks
of the steps before: `Explorer` uncovers the history look by look, in the order in which the policy requests them.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.panorama import CROP, Box, angle_error

AROUND: Final = (0.0, 40.0, -40.0, 80.0, -80.0, 120.0, -120.0, 160.0, -160.0)
"""Turns from a first direction that cover the whole circle, the nearest first.

One more than eight looks: neighbours share 62 columns, more than any plate is wide, so each is whole in one of them.
"""

NEARBY: Final = AROUND[:3]

_EIGHT: Final = (0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)
"""Turns that just cover the circle, for absences at several times, where nine looks each may be too many."""

_SAME_DEG: Final = 1.0
_PLENTY: Final = 1001
"""Looks that a policy may plan with where it looks at fixed pictures, which costs nothing."""


@dataclass(frozen=True)
class Sighting:
    """A mark read in a picture: its box there (pixels), and the panorama angle of the box's centre.

    `width` is the picture's, in pixels. `complete`: whether every field of the mark could be read.
    """

    frame: int
    mark: Mark
    box: Box
    complete: bool
    angle: float
    width: int = CROP

    @property
    def identity(self) -> int:
        """The identity of the mark."""
        return self.mark.identity

    @property
    def whole(self) -> bool:
        """Whether the picture shows the box from side to side."""
        return self.box.x >= 0 and self.box.x + self.box.w <= self.width

    @property
    def quality(self) -> tuple[bool, bool]:
        """Orders sightings of one person at one frame, the best last."""
        return self.whole, self.complete


@dataclass(frozen=True)
class Look:
    """A picture and the marks read in it: a crop, or a whole panorama.

    `left` is the panorama column of its left edge, `name` the observation's where the request has one.
    """

    frame: int
    angle: float
    sightings: tuple[Sighting, ...]
    panorama: bool = False
    name: str = ""
    left: int = 0
    size: tuple[int, int] = (CROP, CROP)

    def shows(self, frame: int, angle: float) -> bool:
        """Whether a look at this frame and angle would repeat this one."""
        return self.frame == frame and same_angle(self.angle, angle)

    def of(self, identity: int) -> Sighting | None:
        """The person's sighting in this picture, if there is one."""
        return next((seen for seen in self.sightings if seen.identity == identity), None)

    def box_inside(self, seen: Sighting) -> Box:
        """A sighting's box in pixels of this picture; for a person over a panorama's seam, the larger part of it."""
        width, _ = self.size
        turns = (seen.box.x + seen.box.w / 2) // width if self.panorama else 0
        return seen.box._replace(x=seen.box.x - width * turns)


class NeedObservation(Exception):  # noqa: N818
    """The next looks to make, all at one frame; more than one where all can be made in one turn."""

    def __init__(self, frame: int, *angles: float) -> None:
        super().__init__(f"frame {frame}, angles {angles}")
        self.frame = frame
        self.angles = angles


class BudgetExhausted(Exception):  # noqa: N818
    """No look is left but the one reserved for the evidence."""


class Explorer:
    """The looks of a question, uncovered in the order in which they were made.

    `frames` are the legal ones, ascending; `left` is how many looks may still be made after these.
    """

    def __init__(self, frames: Sequence[int], looks: Sequence[Look], left: int) -> None:
        self.frames = frames
        self.looks: list[Look] = []
        self._ahead = list(looks)
        self._left = left

    def spare(self) -> int:
        """Looks left at this point, without the one reserved for the evidence."""
        return max(self._left + len(self._ahead) - 1, 0)

    def legal(self, frame: float) -> int:
        """The legal frame nearest to a frame."""
        place = bisect.bisect_left(self.frames, frame)
        return min(self.frames[max(place - 1, 0) : place + 1], key=lambda f: abs(f - frame))

    def look(self, frame: int, angle: float) -> Look:
        """The look at a legal frame.

        Raises NeedObservation if it is the next to make, BudgetExhausted when only one look is left.
        """
        for look in self.looks:
            if look.shows(frame, angle):
                return look
        if self.spare() == 0:
            raise BudgetExhausted
        return self._next(frame, angle)

    def again(self, frame: int, angle: float) -> Look:
        """A new look as near to `angle` as the looks before it allow; takes the last look too."""
        before = [look.angle for look in self.looks if look.frame == frame]
        offset = 0.0
        while any(same_angle(other, angle + offset) for other in before):
            offset = -offset if offset > 0 else 1.5 - offset
        if self._left + len(self._ahead) == 0:
            raise BudgetExhausted
        return self._next(frame, angle + offset)

    def _next(self, frame: int, angle: float) -> Look:
        # A restored look may show somebody earlier than the original did: looks may be left over.
        for look in self._ahead:
            if look.shows(frame, angle):
                return self._uncover(look)
        raise NeedObservation(frame, angle % 360.0)

    def _uncover(self, look: Look) -> Look:
        while self._ahead and not any(look is other for other in self.looks):
            self.looks.append(self._ahead.pop(0))
        return look

    def sightings(self, identity: int) -> list[Sighting]:
        """Every sighting of a person so far, the newest look first."""
        return [seen for look in reversed(self.looks) if (seen := look.of(identity)) is not None]

    def nearest(self, identity: int, frame: float) -> Sighting:
        """The sighting of a person seen before that is nearest in time, the earlier of two."""
        return min(self.sightings(identity), key=lambda seen: (abs(seen.frame - frame), seen.frame))

    def at(self, frame: int) -> list[Sighting]:
        """Everybody seen at a frame, each once: of several sightings the one that shows the box whole."""
        found = [seen for look in self.looks if look.frame == frame for seen in look.sightings]
        people = sorted({seen.identity for seen in found})
        return [max((s for s in found if s.identity == one), key=lambda s: s.quality) for one in people]

    def follow(self, identity: int, frame: float, turns: Sequence[float]) -> Sighting | None:
        """A person seen before, at the legal frame nearest to `frame`.

        Looks at these turns from where the nearest other frame shows the person; None if none of them does.
        """
        frame = self.legal(frame)
        known = self.nearest(identity, frame)
        if known.frame == frame:
            return known
        looks = self._turned(frame, known.angle, turns)
        return next((seen for look in looks if (seen := look.of(identity)) is not None), None)

    def _turned(self, frame: int, angle: float, turns: Sequence[float]) -> Iterator[Look]:
        return (self.look(frame, angle + turn) for turn in turns)


class RestoredExplorer(Explorer):
    """Exploration state restored from the agent's graph or chat: a person's look need not be made again.

    The first `known` looks are uncovered from the start. `rounds` are the frames that may still need a whole circle.
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
        """As `Explorer.follow`; a circle takes eight looks where the frames still to come leave no more."""
        if turns == AROUND:
            self._rounds = max(self._rounds - 1, 0)
            turns = _EIGHT if self.spare() < len(AROUND) + len(_EIGHT) * self._rounds else AROUND
        return super().follow(identity, frame, turns)

    def _turned(self, frame: int, angle: float, turns: Sequence[float]) -> Iterator[Look]:
        # Looks already made at the frame are those of the first turns. Boxes in the graph are rounded, or cut off by a
        # picture's edge, so the angles cannot be derived from them again.
        made = [look for look in (*self.looks, *self._ahead) if look.frame == frame]
        first = made[0].angle if made else angle
        for place, turn in enumerate(turns):
            yield self._uncover(made[place]) if place < len(made) else self.look(frame, first + turn)


class FixedExplorer(Explorer):
    """Exploration state of a fixed set of pictures, all visible from the start. Raises DecodeError for an empty set.

    A policy requests a frame and gets the nearest one that has a picture.
    """

    def __init__(self, looks: Sequence[Look]) -> None:
        if not looks:
            raise DecodeError("the prompt shows no picture")
        super().__init__(sorted({look.frame for look in looks}), (), _PLENTY)
        self.looks = list(looks)

    def look(self, frame: int, angle: float) -> Look:
        """The widest picture of the frame, whatever the angle."""
        return max((look for look in self.looks if look.frame == frame), key=lambda look: look.panorama)

    def again(self, frame: int, angle: float) -> Look:
        """Raises BudgetExhausted: no other picture can be made."""
        raise BudgetExhausted

    def follow(self, identity: int, frame: float, turns: Sequence[float]) -> Sighting | None:
        """The person in the picture nearest to `frame`, if it shows the person."""
        return next((seen for seen in self.at(self.legal(frame)) if seen.identity == identity), None)


def same_angle(a: float, b: float) -> bool:
    """Whether two angles in degrees are so near that the second look would be refused as a duplicate."""
    return float(angle_error(a % 360.0, b % 360.0)) <= _SAME_DEG
