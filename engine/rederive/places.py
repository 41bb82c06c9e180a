"""Where people are: sector and distance as the robot sees them, and where others are from a person.

Left of a person, and from the robot's view, is counter-clockwise seen from above; panorama angles grow clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import pyarrow as pa

from jrdb_avr.engine.rederive.relations import Ties
from jrdb_avr.engine.rederive.truth import FALSE, SLACK, TRUE, UNKNOWN, rows
from jrdb_avr.schema.labels import DISTANCE_BOUNDS_M, DISTANCE_WORDS
from jrdb_avr.schema.rules import Rules

_SIDES: Final = ((0.0, "front"), (30.0, "front {}"), (45.0, "{}"), (135.0, "back {}"), (145.0, "back"))
"""Sectors of a person by the turn, in degrees to either side, at which each begins."""


@dataclass(frozen=True, slots=True)
class _Solid:
    """A 3D box with lidar points: its centre in the robot frame, its heading in radians, its distance in metres."""

    x: float
    y: float
    z: float
    heading: float
    distance: float


class Places(Ties):
    """Places of the people of one sequence, from 2D and 3D boxes."""

    def __init__(self, tables: Mapping[str, pa.Table], rules: Rules) -> None:
        super().__init__(tables, rules)
        self._solids: dict[tuple[int, int], _Solid] = {}
        columns = ("frame", "track", "cx", "cy", "cz", "rot_z", "distance", "num_points")
        for frame, track, x, y, z, turned, metres, points in rows(tables["boxes_3d"], *columns):
            if points:
                away = math.hypot(x, y) if metres is None else metres
                self._solids[frame, track] = _Solid(x, y, z, math.pi - turned, away)
        self._firsts: dict[tuple[int, int, int], dict[int, int]] = {}

    # -- from the robot -----------------------------------------------------------------------------------------

    def distance(self, track: int, frame: int) -> float | None:
        """Metres from the robot where the person has a 2D box, and a 3D box with lidar points."""
        solid = self._solid(track, frame)
        return None if solid is None else solid.distance

    def _solid(self, track: int, frame: int) -> _Solid | None:
        return self._solids.get((frame, track)) if self.box(track, frame) is not None else None

    def sectors(self, track: int, frame: int) -> list[str]:
        """The sectors that the person could be in: two near an edge."""
        found = []
        for word, center in (("ahead", 180.0), ("left", 90.0), ("behind", 0.0), ("right", 270.0)):
            away = abs((self.angle(track, frame) - center + 180) % 360 - 180)
            if away <= 45 + self.rules.load.sector_margin_deg + SLACK:
                found.append(word)
        return found

    def distance_words(self, track: int, frame: int) -> list[str]:
        """The distance words that could be right of the person: two near a bound, all where nothing is known."""
        metres = self.distance(track, frame)
        return list(DISTANCE_WORDS) if metres is None else self._words(metres)

    def _words(self, metres: float) -> list[str]:
        margin = self.rules.load.distance_margin
        found = []
        for i, word in enumerate(DISTANCE_WORDS):
            low = DISTANCE_BOUNDS_M[i - 1] * (1 - margin) - SLACK if i else -math.inf
            high = DISTANCE_BOUNDS_M[i] * (1 + margin) + SLACK if i < len(DISTANCE_BOUNDS_M) else math.inf
            if low <= metres <= high:
                found.append(word)
        return found

    # -- from a person, in space --------------------------------------------------------------------------------

    def seen_from(self, track: int, other: int, sector: str, word: str, frame: int) -> int:
        """Whether another person is in this sector of a person's, at the distance of this word."""
        here, there = self._solid(track, frame), self._solid(other, frame)
        if here is None or there is None:
            return UNKNOWN
        load = self.rules.load
        ahead, left, up = there.x - here.x, there.y - here.y, there.z - here.z
        metres = math.sqrt(ahead**2 + left**2 + up**2)
        if metres > load.pair_max_m + load.pair_margin_m + SLACK:
            return FALSE
        words = [said for said in self._words(metres) if _begins(said) < load.pair_max_m]
        sectors = self._person_sectors(math.degrees(math.atan2(left, ahead) - here.heading))
        if word not in words or sector not in sectors:
            return FALSE
        level = abs(up) <= load.pair_vertical_m
        near = metres < load.pair_max_m - load.pair_margin_m - SLACK
        return TRUE if len(words) == len(sectors) == 1 and level and near else UNKNOWN

    def _person_sectors(self, bearing_deg: float) -> list[str]:
        """The sectors that somebody in this direction, degrees to the left of straight ahead, could be in."""
        turn = (bearing_deg + 180) % 360 - 180
        side, margin = "left" if turn >= 0 else "right", self.rules.load.narrow_sector_margin_deg + SLACK
        found = []
        for i, (begin, name) in enumerate(_SIDES):
            end = _SIDES[i + 1][0] if i + 1 < len(_SIDES) else 180.0
            if begin - margin <= abs(turn) <= end + margin:
                found.append(name.format(side))
        return found

    # -- from a person, as the robot sees it --------------------------------------------------------------------

    def turn(self, track: int, other: int, frame: int, left: bool) -> float:
        """Degrees, [0, 360), from one person to another, turning to the left or to the right."""
        apart = (self.angle(other, frame) - self.angle(track, frame)) % 360.0 % 360.0
        return (360.0 - apart if apart > 0 else 0.0) if left else apart

    def first_beside(self, track: int, other: int, frame: int, left: bool) -> int:
        """Whether another person is the first met when turning from a person to one side."""
        key = (track, frame, int(left))
        if key not in self._firsts:
            self._firsts[key] = self._meet(track, frame, left)
        return self._firsts[key].get(other, FALSE)

    def _meet(self, track: int, frame: int, left: bool) -> dict[int, int]:
        """Everybody who is or could be the first met: one person for certain, or several perhaps."""
        margin, reach = self.rules.load.neighbor_margin_deg, self.rules.load.neighbor_max_deg
        turns = {other: self.turn(track, other, frame, left) for other in self.people(frame) if other != track}
        settling = [turn for other, turn in turns.items() if margin <= turn <= reach and self.clear(other, frame)]
        if not settling:
            return {other: UNKNOWN for other, turn in turns.items() if turn <= reach}
        met = [other for other, turn in turns.items() if turn < min(settling) + margin]
        return {other: TRUE if len(met) == 1 else UNKNOWN for other in met}

    def within(self, track: int, other: int, degrees: int, frame: int, left: bool) -> int:
        """Whether another person is at most so far to one side of a person."""
        margin, turn = self.rules.load.neighbor_margin_deg, self.turn(track, other, frame, left)
        if min(turn, 360.0 - turn) <= margin or abs(turn - degrees) <= margin:
            return UNKNOWN
        return int(turn < degrees)


def _begins(word: str) -> float:
    """Metres at which a distance word begins."""
    place = DISTANCE_WORDS.index(word)
    return DISTANCE_BOUNDS_M[place - 1] if place else 0.0
