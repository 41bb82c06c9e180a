"""Association: which entity each person read in a picture is, from the place where each is expected and who they are.

A person is expected where constant speed between the nearest sightings leads, in angle and in size, or still at the
nearest one; the less exactly the farther these are in time. Gender and age, as read so far, speak for or against. All
people of a picture are assigned together; whoever fits nobody well enough is new.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.perceive.readings import USUAL, PersonReading
from jrdb_avr.agent.perceive.votes import Tracks
from jrdb_avr.schema.labels import AGES, GENDERS
from jrdb_avr.schema.panorama import WIDTH, angle_error

NEW: Final = -0.5
"""Cost above which a person is taken for somebody new; a cost is minus the log-odds of being the same person."""

AMBIGUOUS: Final = 1.0
"""Log-odds by which an assignment should be better than the next one."""

NOBODY: Final = 0
"""The number of somebody who is none of the people of a picture."""

_CERTAIN: Final = 1000.0

_EXACT_DEG: Final = 1.5
_DRIFT: Final = 0.7
"""Growth of the uncertainty of a person's angle, in degrees per frame, if the speed is unknown."""

_TURNING: Final = 0.25
"""The same growth if the speed is known from two sightings."""

_STAYING: Final = 0.5
"""The same growth if the person is assumed to stay in place."""

_WIDEST_DEG: Final = 120.0
_LONGEST: Final = 60
"""Frames for which somebody is expected to go on as they did."""

_SLOWED: Final = 25
"""Frames after which half of the way at their speed is expected: some stop, and some turn back.

On JRDB's labels 25 and 45 leave the same share of people in view, to a hundredth; on samples 25 loses fewer.
"""

_ASTRAY: Final = 0.05
"""The chance that a box is wrong or a person has done the unexpected; they are then this near all the same."""

_ASTRAY_HERE: Final = 0.005
"""The same at a frame at which the person was seen before: only a wrong box moves somebody within a frame."""

_ASTRAY_DEG: Final = 30.0
_ANYWHERE: Final = 0.001

_GROWING: Final = 0.006
"""Spread of the logarithm of a box's height per frame."""

_VALUES: Final = {"gender": len(GENDERS), "age": len(AGES)}


class ExpectedPlace(NamedTuple):
    """Where somebody is expected at a frame: panorama angle and height of the box, each with its spread."""

    angle: float
    angle_spread: float
    log_height: float
    height_spread: float


class Match(NamedTuple):
    """The entity that a person of a picture is, "" for a new one, and by how much the next choice is worse."""

    entity: str
    cost: float
    margin: float

    @property
    def ambiguous(self) -> bool:
        """Whether a second opinion is worth asking for."""
        return self.margin < AMBIGUOUS


def expected_place(readings: Sequence[PersonReading], frame: int) -> ExpectedPlace:
    """Where somebody with these readings (at least one) is expected at a frame."""
    # Of several readings at a frame, the last that shows the person whole.
    seen = {one.frame: one for one in sorted(readings, key=lambda one: (one.frame, one.whole))}
    near = sorted(seen, key=lambda at: (abs(at - frame), at))
    first = near[0]
    gap = abs(first - frame)
    second = next((at for at in near[1:] if (at - frame) * (first - frame) <= 0), near[1] if len(near) > 1 else None)
    angle, height = seen[first].angle, math.log(seen[first].box.h)
    drift = _DRIFT
    if second is not None and abs(second - first) <= 2 * _LONGEST:
        passed = (frame - first) / (second - first)
        if passed < 0:
            longest = min(gap, _LONGEST)
            passed = -(0.5 ** (longest / _SLOWED)) * longest / abs(second - first)
        turn = (seen[second].angle - angle + 180.0) % 360.0 - 180.0
        angle += passed * turn
        drift = min(_DRIFT, _TURNING + _EXACT_DEG / abs(second - first))
        if passed > 0:
            height += passed * (math.log(seen[second].box.h) - height)
    # The second modulo catches a tiny negative angle, whose first modulo rounds to 360.
    return ExpectedPlace(angle % 360.0 % 360.0, _spread(drift, gap), height, 0.15 + min(_GROWING * gap, 0.6))


def match_people(
    tracks: Tracks, readings: Sequence[PersonReading], recognized: Mapping[str, int] | None = None
) -> list[Match]:
    """Assign the people read in one picture to the entities seen before.

    recognized: numbers of the people who are known to be certain entities, `NOBODY` for one who is not in the picture.
    """
    known = list(tracks.people)
    costs = [[_cost(tracks, who, one) for who in known] + [NEW] * len(readings) for one in readings]
    for who, number in (recognized or {}).items():
        for row, one in zip(costs, readings, strict=True):
            row[known.index(who)] = -_CERTAIN if one.number == number else _CERTAIN
    matches = []
    for row, column in zip(costs, assign(costs), strict=True):
        others = [cost for at, cost in enumerate(row[: len(known) + 1]) if at != min(column, len(known))]
        margin = min(others, default=math.inf) - row[column]
        matches.append(Match(known[column] if column < len(known) else "", row[column], margin))
    return matches


def with_picture(
    tracks: Tracks,
    frame: int,
    seen: SeenColumns,
    readings: Sequence[PersonReading],
    recognized: Mapping[str, int] | None = None,
) -> Tracks:
    """The tracks with one more look and the people read in it; new entities are called p1, p2, ...

    recognized: as in `match_people`.
    """
    people = dict(tracks.people)
    for reading, match in zip(readings, match_people(tracks, readings, recognized), strict=True):
        who = match.entity or f"p{len(people) + 1}"
        people[who] = (*people.get(who, ()), reading)
    return Tracks(people, {**tracks.looks, frame: (*tracks.looks.get(frame, ()), seen)})


def _cost(tracks: Tracks, who: str, reading: PersonReading) -> float:
    """Minus the log-odds that the person read is this entity, rather than anybody anywhere."""
    readings = tracks.people[who]
    place = expected_place(readings, reading.frame)
    # Boxes of one person at the edges of two looks differ by what is cut off.
    widths = [abs(one.box.w - reading.box.w) for one in readings if one.frame == reading.frame]
    spread = place.angle_spread + min(widths, default=0.0) * 180.0 / WIDTH
    nearest = min(readings, key=lambda one: abs(one.frame - reading.frame))
    still = spread - place.angle_spread + _spread(_STAYING, abs(nearest.frame - reading.frame))
    off = angle_error(reading.angle, place.angle)
    goes_on, astray = _normal(off, spread), _normal(off, max(spread, _ASTRAY_DEG))
    stays = _normal(angle_error(reading.angle, nearest.angle), still)
    share = _ASTRAY if nearest.frame != reading.frame else _ASTRAY_HERE
    near = (1 - share) * (goes_on + stays) / 2 + share * astray + _ANYWHERE / 360.0
    grown = math.log(reading.box.h) - place.log_height
    sized = (1 - _ASTRAY) * _normal(grown, place.height_spread) / _normal(grown, 0.8) + _ASTRAY
    return -(math.log(near * 360.0) + math.log(sized) + sum(_same(tracks, who, reading, topic) for topic in _VALUES))


def _same(tracks: Tracks, who: str, reading: PersonReading, topic: str) -> float:
    """The log-odds that a timeless attribute as read gives for being this entity."""
    read = next((label.value for label in reading.labels if label.topic == topic and label.holds), None)
    odds = {tally.value: math.exp(tally.weight) for tally in tracks.values(who, topic, None)}
    if read is None or not odds:
        return 0.0
    values = _VALUES[topic]
    share = odds.get(read, 1.0) / (sum(odds.values()) + values - len(odds))
    return math.log(values * (USUAL * share + (1 - USUAL) / (values - 1) * (1 - share)))


def _spread(drift: float, gap: int) -> float:
    return min(_EXACT_DEG + drift * gap, _WIDEST_DEG)


def _normal(off: float, spread: float) -> float:
    return math.exp(-0.5 * (off / spread) ** 2) / (spread * math.sqrt(2 * math.pi))


def assign(costs: Sequence[Sequence[float]]) -> list[int]:
    """The column of each row, all different, with the least sum of costs; there are at least as many columns as rows.

    Jonker and Volgenant's shortest augmenting paths: row after row takes the cheapest column, where others may have to
    move on; the prices of rows and columns keep all reduced costs at 0 or above.
    """
    rows, columns = len(costs), len(costs[0]) if costs else 0
    row_price, column_price = [0.0] * rows, [0.0] * columns
    owner = [-1] * columns
    for new in range(rows):
        least, before, done = [math.inf] * columns, [-1] * columns, [False] * columns
        row, column = new, -1
        while row >= 0:
            for other in range(columns):
                reduced = costs[row][other] - row_price[row] - column_price[other]
                if not done[other] and reduced < least[other]:
                    least[other], before[other] = reduced, column
            following = min((one for one in range(columns) if not done[one]), key=least.__getitem__)
            paid = least[following]
            row_price[new] += paid
            for other in range(columns):
                if done[other]:
                    row_price[owner[other]] += paid
                    column_price[other] -= paid
                else:
                    least[other] -= paid
            done[following] = True
            row, column = owner[following], following
        while column >= 0:
            owner[column] = owner[before[column]] if before[column] >= 0 else new
            column = before[column]
    taken = {row: column for column, row in enumerate(owner) if row >= 0}
    return [taken[row] for row in range(rows)]
