"""Fused readings: each reading is a vote on the person's attributes, relations, distance and box at a frame.

No reading replaces another. Two that agree, or three of which two agree, settle a fact. Misreadings of one person are
often alike, so that a fact is supported by at most `MOST_VOTES` readings: else whoever is seen often would win.
Readings count at the frame that was looked at; where there is none, those of the nearest frame count less by half for
each second, and settle nothing farther than a second away.
"""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal, NamedTuple

from jrdb_avr.agent.perceive.geometry import (
    DERIVED,
    SeenColumns,
    angle_of,
    around,
    at_distance,
    covered,
    in_sector,
    standing,
)
from jrdb_avr.agent.perceive.readings import USUAL, PersonReading, ReadLabel, has_one_value, topic_of
from jrdb_avr.schema.beliefs import TIMELESS
from jrdb_avr.schema.labels import may_be_called
from jrdb_avr.schema.panorama import WIDTH, Box, iou
from jrdb_avr.schema.relations import SAME_GROUP, SYMMETRIC
from jrdb_avr.schema.rules import KEYFRAME_STEP

SlotState = Literal["open", "supported", "certain", "contradicted"]

UNIT: Final = math.log(USUAL / (1 - USUAL))
"""Log-odds of one reading of the usual confidence, and the most that one reading counts."""

MOST_VOTES: Final = 1.5
"""The most readings by which a fact counts as supported or contradicted."""

SETTLING: Final = 2
"""Number of agreeing readings that settles a fact, if they outnumber those that disagree."""

SAME_BOX: Final = 0.5
"""IoU from which on two boxes are of one cluster, as scores want it."""


class Support(NamedTuple):
    """What readings say of one statement: log-odds for it (capped), and how many are for and against it."""

    log_odds: float = 0.0
    votes: int = 0
    against: int = 0

    @property
    def state(self) -> SlotState:
        """The state of a slot with this support."""
        if self.log_odds == 0:
            return "open"
        if self.log_odds < 0:
            return "contradicted"
        return "certain" if self.settled else "supported"

    @property
    def settled(self) -> bool:
        """Whether more readings would hardly change it."""
        return max(self.votes, self.against) >= SETTLING and self.votes != self.against


class Tally(NamedTuple):
    """A value of an attribute, the readings that give it, and their weight in log-odds."""

    value: str
    votes: int
    weight: float


class FusedBox(NamedTuple):
    """The box that most readings of a person at a frame agree on, and how many do."""

    box: Box
    votes: int


@dataclass(frozen=True)
class Tracks:
    """Everybody seen so far: readings by entity, in the order in which they were made, and looks by frame."""

    people: Mapping[str, tuple[PersonReading, ...]]
    looks: Mapping[int, tuple[SeenColumns, ...]]

    # -- attributes -----------------------------------------------------------------------------------------------

    def statement(self, who: str, name: str, value: str, frame: int | None) -> Support:
        """The support for an attribute's value (as `Condition.wanted` writes it) of somebody at a frame."""
        if name == "group_size":
            return self._group_size(who, int(value), frame or 0)
        said = [(one.frame, _says(one, name, value)) for one in self.people.get(who, ())]
        votes = [(at, vote) for at, vote in said if vote is not None]
        if name == "interaction":
            ties = [one for one in self._tied if one[1] == value and who in (one[0], one[2])]
            votes += [(at, vote) for *_, at, vote in ties if vote > 0]
        return _support(votes, None if name in TIMELESS else frame)

    def _group_size(self, who: str, size: int, frame: int) -> Support:
        """The support for so many people in somebody's group: by the group's ties, or as it was read."""
        at = self.nearest_looked(frame)
        if not any(relation == SAME_GROUP for _, relation, *_ in self._tied):
            said = [(one.frame, _says(one, "group_size", str(size))) for one in self.people.get(who, ())]
            return _support([(when, vote) for when, vote in said if vote is not None], frame)
        known = len(self._group(who, at))
        if not self.at(who, at) or (known < size and not covered(self.looks.get(at, ()))):
            return Support()
        # Of a group that looks too small somebody may be hidden.
        vote = UNIT if known == size else -UNIT if known > size or size == 1 else -UNIT / 2
        return _support([(at, vote)] * len(self.at(who, at)), frame)

    def _group(self, who: str, frame: int) -> set[str]:
        """Everybody whom ties of one group join to somebody at a frame, with them."""
        if (who, frame) not in self._groups:
            there = [other for other in self.people if self.at(other, frame)]
            group, fresh = {who}, [who]
            while fresh:
                one = fresh.pop()
                found = [o for o in there if o not in group and self._told(one, SAME_GROUP, o, frame).log_odds > 0]
                group.update(found)
                fresh += found
            self._groups[who, frame] = group
        return self._groups[who, frame]

    def values(self, who: str, topic: str, frame: int | None) -> tuple[Tally, ...]:
        """The values that were read on a topic of somebody, the best supported first; at any frame where it is None."""
        readings = [one for one in self.people.get(who, ()) if any(label.topic == topic for label in one.labels)]
        if frame is not None and topic not in TIMELESS:
            nearest = min((one.frame for one in readings), key=lambda at: (abs(at - frame), at), default=frame)
            readings = [one for one in readings if one.frame == nearest]
        votes: dict[str, list[float]] = defaultdict(list)
        for label in (label for one in readings for label in one.labels if label.topic == topic):
            votes[label.value].append(_weight(label))
        tallies = (Tally(value, sum(w > 0 for w in given), sum(given)) for value, given in votes.items())
        return tuple(sorted(tallies, key=lambda tally: (-tally.weight, tally.value)))

    def metres(self, who: str, frame: int) -> float | None:
        """The median of the distances that were read at a frame."""
        read = [one.metres for one in self.at(who, frame) if one.metres is not None]
        return statistics.median(read) if read else None

    # -- places ---------------------------------------------------------------------------------------------------

    def at(self, who: str, frame: int) -> list[PersonReading]:
        """The readings of somebody at exactly this frame."""
        return [one for one in self.people.get(who, ()) if one.frame == frame]

    def agreed(self, who: str, frame: int) -> PersonReading | None:
        """Return the reading of a person at a frame whose box agrees with the most other readings; None without any.

        Of equal ones a person who was wholly in the picture comes first, then the box that overlaps the others most.
        """
        readings = self.at(who, frame)

        def agreement(one: PersonReading) -> tuple[int, bool, float]:
            shares = [share for other in readings if (share := iou(one.box, other.box)) >= SAME_BOX]
            return len(shares), one.whole, sum(shares)

        return max(readings, key=agreement, default=None)

    def agreeing(self, one: PersonReading, who: str) -> int:
        """How many readings of somebody at the frame of one of them, it included, have the same box."""
        return sum(iou(one.box, other.box) >= SAME_BOX for other in self.at(who, one.frame))

    def box(self, who: str, frame: int) -> FusedBox | None:
        """The box of the reading of somebody at a frame that most readings agree with; None where there is none."""
        if (who, frame) not in self._fused:
            best = self.agreed(who, frame)
            self._fused[who, frame] = None if best is None else FusedBox(best.box, self.agreeing(best, who))
        return self._fused[who, frame]

    def boxes(self, frame: int) -> dict[str, Box]:
        """The boxes of those who are likely to be there at a frame: more looks at their place show them than do not."""
        found = {who: self.box(who, frame) for who in self.people}
        return {who: box.box for who, box in found.items() if box is not None and self.missed(who, frame) <= 0}

    def missed(self, who: str, frame: int) -> int:
        """How many more looks at somebody's place do not show them at a frame than do."""
        return self.looks_at(who, frame) - 2 * len(self.at(who, frame))

    def looks_at(self, who: str, frame: int) -> int:
        """How many looks at a frame show the place at which most readings have somebody."""
        box = self.box(who, frame)
        if box is None:
            return 0
        place = around(angle_of(box.box), box.box.w * 180.0 / WIDTH)
        return sum(covered([look], place) for look in self.looks.get(frame, ()))

    def nearest_looked(self, frame: int) -> int:
        """The frame that stands for a stated one: of those looked at the nearest, itself where there is none."""
        return min(self.looks, key=lambda other: (abs(other - frame), other), default=frame)

    # -- relations ------------------------------------------------------------------------------------------------

    def relation(self, source: str, relation: str, target: str, frame: int) -> Support:
        """The support for a relation at a frame: from boxes where these decide, else from readings of either person.

        Two people whom no picture shows together are of one group where others join them.
        """
        if relation in DERIVED:
            return self._derived(source, relation, target, self.nearest_looked(frame), frame)
        told, at = self._told(source, relation, target, frame), self.nearest_looked(frame)
        if relation == SAME_GROUP and told == Support() and target in self._group(source, at):
            return _support([(at, UNIT)], frame)
        return told

    def _told(self, source: str, relation: str, target: str, frame: int) -> Support:
        return _support(self._votes_of_ties.get(_tie_key(source, relation, target), ()), frame)

    def _derived(self, source: str, relation: str, target: str, at: int, frame: int) -> Support:
        first, second, boxes = self.box(source, at), self.box(target, at), self._boxes_at(at)
        if first is None or second is None or source not in boxes or target not in boxes:
            return Support()
        holds = standing(relation, boxes, source, target, self.looks.get(at, ()))
        if holds is None:
            return Support()
        votes = min(first.votes, second.votes)
        return _support([(at, UNIT if holds else -UNIT)] * votes, frame)

    def _boxes_at(self, frame: int) -> dict[str, Box]:
        if frame not in self._boxes:
            self._boxes[frame] = self.boxes(frame)
        return self._boxes[frame]

    @cached_property
    def _fused(self) -> dict[tuple[str, int], FusedBox | None]:
        return {}

    @cached_property
    def _groups(self) -> dict[tuple[str, int], set[str]]:
        return {}

    @cached_property
    def _boxes(self) -> dict[int, dict[str, Box]]:
        return {}

    @cached_property
    def _votes_of_ties(self) -> dict[tuple[str, str, str], list[tuple[int, float]]]:
        """Frame and weight of each reading of a relation: everybody is ranked with everybody, in time for any crowd."""
        found: dict[tuple[str, str, str], list[tuple[int, float]]] = defaultdict(list)
        for source, relation, target, at, vote in self._tied:
            found[_tie_key(source, relation, target)].append((at, vote))
        return found

    @cached_property
    def _tied(self) -> list[tuple[str, str, str, int, float]]:
        """Relations as read: source, relation, target, frame and weight."""
        names = {(one.observation, one.number): who for who, readings in self.people.items() for one in readings}
        return [
            (who, tie.relation, names[one.observation, tie.other], one.frame, _signed(tie.holds, tie.confidence))
            for who, readings in self.people.items()
            for one in readings
            for tie in one.ties
            if (one.observation, tie.other) in names
        ]


def _tie_key(source: str, relation: str, target: str) -> tuple[str, str, str]:
    """The ends and the name of a relation, the same from both ends where it holds both ways."""
    first, last = sorted((source, target)) if relation in SYMMETRIC else (source, target)
    return first, relation, last


def settled(tallies: Sequence[Tally]) -> bool:
    """Whether the first of these values is settled."""
    others = max((tally.votes for tally in tallies[1:]), default=0)
    return bool(tallies) and tallies[0].votes >= SETTLING and tallies[0].votes > others


def _support(votes: Sequence[tuple[int, float]], frame: int | None) -> Support:
    """Fuse votes, each with its frame: those of the frame nearest to this one, or all where there is none."""
    if not votes:
        return Support()
    nearest = min((at for at, _ in votes), key=lambda at: (abs(at - (frame or 0)), at))
    given = [vote for at, vote in votes if frame is None or at == nearest]
    gap = 0 if frame is None else abs(nearest - frame)
    most = MOST_VOTES * UNIT
    log_odds = max(-most, min(most, sum(given))) * 0.5 ** (gap / KEYFRAME_STEP)
    if gap > KEYFRAME_STEP:
        # Far away they rank people and decide nothing.
        return Support(log_odds, int(log_odds > 0), int(log_odds < 0))
    return Support(log_odds, sum(one > 0 for one in given), sum(one < 0 for one in given))


def _says(reading: PersonReading, name: str, value: str) -> float | None:
    """The vote of one reading on a statement, None where it says nothing."""
    if name == "sector":
        return _vote(in_sector(reading.angle, value))
    if name == "distance" and reading.metres is not None:
        return _vote(at_distance(reading.metres, value))
    topic = topic_of(name, value)
    votes = [_label_says(label, value) for label in reading.labels if label.topic == topic]
    given = [vote for vote in votes if vote is not None]
    return max(given, key=abs) if given else None


def _label_says(label: ReadLabel, value: str) -> float | None:
    """The vote of a label on a value of its topic; None where the value may be said of the label too, or was not."""
    if label.value == value:
        return _weight(label)
    excluded = label.holds and has_one_value(label.topic) and label.value not in may_be_called(value)
    return -_weight(label) if excluded else None


def _weight(label: ReadLabel) -> float:
    return _signed(label.holds, label.confidence)


def _signed(holds: bool, confidence: float) -> float:
    """The log-odds of one reading."""
    sure = min(max(confidence, 0.5), USUAL)
    return math.log(sure / (1 - sure)) * (1 if holds else -1)


def _vote(holds: bool | None) -> float | None:
    return None if holds is None else UNIT if holds else -UNIT
