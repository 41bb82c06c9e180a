"""Evidence of readings: each reading is a vote on the attributes, relations and boxes of a person at a frame.

No reading replaces another one. Errors of a model often repeat. So a further reading of a topic in the same frame
counts `Repeats.frame`, and the readings of frames other than the nearest count `Repeats.person`. Evidence is halved for
each second between the frame of a reading and the frame of the statement.
"""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, Literal, NamedTuple

from jrdb_avr.agent.perceive.geometry import (
    DERIVED,
    SeenColumns,
    Truth,
    angle_of,
    around,
    at_distance,
    covered,
    in_sector,
    standing,
)
from jrdb_avr.agent.perceive.readings import CONFIDENCE, PersonReading, ReadLabel, has_one_value, topic_of
from jrdb_avr.schema.beliefs import TIMELESS
from jrdb_avr.schema.labels import may_be_called
from jrdb_avr.schema.panorama import WIDTH, Box
from jrdb_avr.schema.relations import SAME_GROUP, SYMMETRIC
from jrdb_avr.schema.repeats import USUAL_REPEATS, Repeats
from jrdb_avr.schema.rules import KEYFRAME_STEP

SlotState = Literal["open", "supported", "certain", "contradicted"]

UNIT: Final = math.log(CONFIDENCE / (1 - CONFIDENCE))
"""Log-odds of one reading."""

CAP: Final = 1.5 * UNIT
"""Maximum log-odds for or against a statement."""

CERTAIN: Final = 2.0
"""Minimum log-odds of a certain statement."""


class Support(NamedTuple):
    """Evidence for one statement: the log-odds, capped. 0 if no reading says something."""

    log_odds: float = 0.0

    @property
    def state(self) -> SlotState:
        """The state of a part of a plan with this support."""
        if self.log_odds == 0:
            return "open"
        if self.log_odds < 0:
            return "contradicted"
        return "certain" if self.log_odds >= CERTAIN else "supported"


TieKey = tuple[str, str, str]
"""Source, name and target of a relation."""

Vote = tuple[int, float]
"""Frame of a reading, and its log-odds for a statement (0 if the reading says nothing about the statement)."""


def fuse(votes: Iterable[Vote], frame: int | None, repeats: Repeats = USUAL_REPEATS) -> float:
    """Return the log-odds of a statement by the votes of one person's readings.

    Args:
        votes: Votes in the order of the readings. Each vote contains the weight of its reading in its frame.
        frame: Frame of the statement. None if the statement holds at all frames.
        repeats: Weights of repeated readings.

    Returns:
        The log-odds, from -`CAP` to `CAP`.
    """
    sums: dict[int, float] = defaultdict(float)
    for at, vote in votes:
        sums[at] += vote
    if not sums:
        return 0.0
    nearest = next(iter(sums))
    if frame is not None and len(sums) > 1:
        nearest = min(sums, key=lambda at: (abs(at - frame), at))
    total = sum(
        vote * (1.0 if at == nearest else repeats.person) * (1.0 if frame is None else decay(at - frame))
        for at, vote in sums.items()
    )
    return max(-CAP, min(CAP, total))


def decay(frames: int) -> float:
    """Return the weight of a reading that is this number of frames away: one half for each second."""
    return float(0.5 ** (abs(frames) / KEYFRAME_STEP))


@dataclass(frozen=True)
class Tracks:
    """All people seen so far.

    people: readings of each entity, in the order of the readings. looks: columns of the looks of each frame. repeats:
    weights of repeated readings.
    """

    people: Mapping[str, tuple[PersonReading, ...]]
    looks: Mapping[int, tuple[SeenColumns, ...]]
    repeats: Repeats = USUAL_REPEATS
    # Tables that are filled on use.
    _standing: dict[tuple[str, str, int], dict[str, Truth]] = field(default_factory=dict, init=False, compare=False)
    _groups: dict[tuple[str, int], list[str]] = field(default_factory=dict, init=False, compare=False)
    _boxes: dict[int, dict[str, Box]] = field(default_factory=dict, init=False, compare=False)

    def with_people(
        self, columns: SeenColumns | None, frame: int, people: Sequence[tuple[str, PersonReading]]
    ) -> Tracks:
        """Return the tracks with one more picture.

        Args:
            columns: Columns that the picture shows. None for more people of a picture that the tracks have.
            frame: Frame of the picture.
            people: Entity and reading of each person in the picture.

        Returns:
            New tracks.
        """
        readings = dict(self.people)
        for entity, reading in people:
            readings[entity] = (*readings.get(entity, ()), reading)
        looks = {**self.looks, frame: (*self.looks.get(frame, ()), *([columns] if columns else []))}
        return Tracks(readings, looks, self.repeats)

    # -- attributes -----------------------------------------------------------------------------------------------

    def statement(self, entity: str, name: str, value: str, frame: int | None) -> Support:
        """Return the support for a value of an attribute.

        Args:
            entity: The person.
            name: Attribute, as `Condition.wanted` names it.
            value: Value, as `Condition.wanted` writes it.
            frame: Frame of the statement. None for any frame.

        Returns:
            The support.
        """
        if name == "group_size":
            return self._group_size(entity, int(value), frame or 0)
        votes = self._votes(entity, name, value)
        if name == "interaction":
            # A positive reading of a relation of this name is a reading of the interaction too.
            ties = (votes for key, votes in self._tie_votes.items() if key[1] == value and entity in (key[0], key[2]))
            votes += [(at, vote) for tie in ties for at, vote in tie if vote > 0]
        return self._support(votes, None if name in TIMELESS else frame)

    def _votes(self, entity: str, name: str, value: str) -> list[Vote]:
        """Return the votes of a person's readings on a value."""
        topic, votes, frames = topic_of(name, value), list[Vote](), set[int]()
        for reading in self.people.get(entity, ()):
            vote = _vote_of(reading, name, value, topic)
            if vote is not None:
                votes.append((reading.frame, vote * (self.repeats.frame if reading.frame in frames else 1.0)))
                frames.add(reading.frame)
        return votes

    def _support(self, votes: Sequence[Vote], frame: int | None) -> Support:
        return Support(fuse(votes, frame, self.repeats))

    def _group_size(self, entity: str, size: int, frame: int) -> Support:
        """Return the support for a number of people in a group: by relations, or as it was read."""
        at = self.nearest_looked(frame)
        if not any(relation == SAME_GROUP for _, relation, _ in self._tie_votes):
            return self._support(self._votes(entity, "group_size", str(size)), frame)
        count = len(self._group(entity, at))
        if not self.readings_at(entity, at) or (count < size and not covered(self.looks.get(at, ()))):
            return Support()
        # If a group looks too small, a member may be hidden.
        vote = UNIT if count == size else -UNIT if count > size or size == 1 else -UNIT / 2
        return self._support([(at, vote)], frame)

    def _group(self, entity: str, frame: int) -> list[str]:
        """Return the person and all people that relations of one group join to the person at a frame."""
        if (entity, frame) not in self._groups:
            present = [partner for partner in self.people if self.readings_at(partner, frame)]
            group = [entity]
            # The list grows while it is read.
            for member in group:
                strangers = [partner for partner in present if partner not in group]
                group += [name for name in strangers if self._tie(member, SAME_GROUP, name, frame).log_odds > 0]
            self._groups[entity, frame] = group
        return self._groups[entity, frame]

    def values(self, entity: str, topic: str, frame: int | None) -> dict[str, float]:
        """Return the log-odds of the values that were read on a topic, the highest first.

        Args:
            entity: The person.
            topic: The topic.
            frame: Only the nearest frame with a reading of the topic counts. None for all frames.

        Returns:
            The log-odds by value.
        """
        readings = [
            reading for reading in self.people.get(entity, ()) if any(label.topic == topic for label in reading.labels)
        ]
        if frame is not None and topic not in TIMELESS:
            nearest = min((reading.frame for reading in readings), key=lambda at: (abs(at - frame), at), default=frame)
            readings = [reading for reading in readings if reading.frame == nearest]
        votes: dict[str, list[Vote]] = defaultdict(list)
        frames: set[int] = set()
        for reading in readings:
            factor = self.repeats.frame if reading.frame in frames else 1.0
            frames.add(reading.frame)
            for label in reading.labels:
                if label.topic == topic:
                    votes[label.value].append((reading.frame, signed(label.holds) * factor))
        odds = {value: fuse(given, None, self.repeats) for value, given in votes.items()}
        return dict(sorted(odds.items(), key=lambda pair: (-pair[1], pair[0])))

    def metres(self, entity: str, frame: int) -> float | None:
        """Return the median of the distances in metres that were read at a frame, None without any."""
        distances = [reading.metres for reading in self.readings_at(entity, frame) if reading.metres is not None]
        return statistics.median(distances) if distances else None

    # -- places ---------------------------------------------------------------------------------------------------

    def readings_at(self, entity: str, frame: int) -> list[PersonReading]:
        """Return the readings of a person at exactly this frame."""
        return self._by_frame.get((entity, frame), [])

    def best_reading(self, entity: str, frame: int) -> PersonReading | None:
        """Return the first reading of a person at a frame that shows the person whole, else the first, else None."""
        return max(self.readings_at(entity, frame), key=lambda reading: reading.whole, default=None)

    def box(self, entity: str, frame: int) -> Box | None:
        """Return the box of the best reading of a person at a frame in stitched pixels, None without a reading."""
        reading = self.best_reading(entity, frame)
        return None if reading is None else reading.box

    def boxes(self, frame: int) -> dict[str, Box]:
        """Return the boxes of the people who are likely to be present at a frame."""
        if frame not in self._boxes:
            boxes = {entity: self.box(entity, frame) for entity in self.people}
            self._boxes[frame] = {
                entity: box for entity, box in boxes.items() if box is not None and self.missed(entity, frame) <= 0
            }
        return self._boxes[frame]

    def missed(self, entity: str, frame: int) -> int:
        """Return the number of looks at a person's box that do not show the person, minus the number that do."""
        return self.looks_at(entity, frame) - 2 * len(self.readings_at(entity, frame))

    def looks_at(self, entity: str, frame: int) -> int:
        """Return the number of looks at a frame that show the whole box of a person."""
        box = self.box(entity, frame)
        if box is None:
            return 0
        arc = around(angle_of(box), box.w * 180.0 / WIDTH)
        return sum(covered([look], arc) for look in self.looks.get(frame, ()))

    def nearest_looked(self, frame: int) -> int:
        """Return the frame with a look that is nearest to a frame; the frame itself if there are no looks."""
        return min(self.looks, key=lambda at: (abs(at - frame), at), default=frame)

    # -- relations ------------------------------------------------------------------------------------------------

    def relation(self, source: str, relation: str, target: str, frame: int) -> Support:
        """Return the support for a relation at a frame.

        Args:
            source: Person at the start of the relation.
            relation: Name of the relation.
            target: Person at the end of the relation.
            frame: The frame.

        Returns:
            The support by boxes if boxes decide the relation, else by readings of either person. Two people that no
            picture shows together are of one group if other people join them.
        """
        at = self.nearest_looked(frame)
        if relation in DERIVED:
            return self._derived(source, relation, target, at, frame)
        support = self._tie(source, relation, target, frame)
        if relation == SAME_GROUP and support == Support() and target in self._group(source, at):
            return self._support([(at, UNIT)], frame)
        return support

    def _tie(self, source: str, relation: str, target: str, frame: int) -> Support:
        return self._support(self._tie_votes.get(tie_key(source, relation, target), ()), frame)

    def tie_votes(self, key: TieKey, frame: int) -> list[float]:
        """Return the weighted votes of readings at a frame on the relation with this key."""
        return [vote for at, vote in self._tie_votes.get(key, ()) if at == frame]

    def _derived(self, source: str, relation: str, target: str, at: int, frame: int) -> Support:
        boxes = self.boxes(at)
        if source not in boxes or target not in boxes:
            return Support()
        key = relation, source, at
        if key not in self._standing:
            self._standing[key] = standing(relation, boxes, source, self.looks.get(at, ()))
        holds = self._standing[key].get(target)
        return Support() if holds is None else self._support([(at, signed(holds))], frame)

    # -- tables that are computed once ------------------------------------------------------------------------------

    @cached_property
    def _by_frame(self) -> dict[tuple[str, int], list[PersonReading]]:
        table: dict[tuple[str, int], list[PersonReading]] = defaultdict(list)
        for entity, readings in self.people.items():
            for reading in readings:
                table[entity, reading.frame].append(reading)
        return dict(table)

    @cached_property
    def _tie_votes(self) -> dict[TieKey, list[Vote]]:
        """The votes on each relation in the order of the pictures, with the weight of each reading in its frame."""
        pairs = [(entity, reading) for entity, readings in self.people.items() for reading in readings]
        entities = {(reading.observation, reading.number): entity for entity, reading in pairs}
        # Names of observations count up, so that a longer name is a later one.
        pairs.sort(key=lambda pair: (len(pair[1].observation), pair[1].observation, pair[1].number))
        table: dict[TieKey, list[Vote]] = {}
        for entity, reading in pairs:
            for tie in sorted(reading.ties, key=lambda tie: tie.other):
                target = entities.get((reading.observation, tie.other))
                if target is not None:
                    votes = table.setdefault(tie_key(entity, tie.relation, target), [])
                    repeated = any(at == reading.frame for at, _ in votes)
                    vote = signed(tie.holds) * (self.repeats.frame if repeated else 1.0)
                    votes.append((reading.frame, vote))
        return table


def tie_key(source: str, relation: str, target: str) -> TieKey:
    """Return source, name and target of a relation. A symmetric relation has the same key from both ends."""
    first, last = sorted((source, target)) if relation in SYMMETRIC else (source, target)
    return first, relation, last


def signed(holds: bool) -> float:
    """Return the log-odds of one reading that affirms or denies a statement."""
    return UNIT if holds else -UNIT


def _vote_of(reading: PersonReading, name: str, value: str, topic: str) -> float | None:
    """Return the vote of a reading on a value, 0 if it leaves the value open, None without a reading of the topic."""
    if name == "sector":
        return _truth_vote(in_sector(reading.angle, value))
    if name == "distance" and reading.metres is not None:
        return _truth_vote(at_distance(reading.metres, value))
    votes = [vote_of_label(label, value) for label in reading.labels if label.topic == topic]
    # Labels that contradict each other cancel out. Labels that agree count as one.
    return max(0.0, *votes) + min(0.0, *votes) if votes else None


def vote_of_label(label: ReadLabel, value: str) -> float:
    """Return the log-odds that a label gives for a value of its topic, 0 if the value may be said of the label too."""
    if label.value == value:
        return signed(label.holds)
    excluded = label.holds and has_one_value(label.topic) and label.value not in may_be_called(value)
    return -UNIT if excluded else 0.0


def _truth_vote(holds: bool | None) -> float:
    return 0.0 if holds is None else signed(holds)
