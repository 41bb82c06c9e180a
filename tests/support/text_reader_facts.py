"""Words of questions as facts of the raw labels, under one reading of the words.

A fact is True, False, or None where the labels do not say.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from text_reader_labels import CERTAIN, Recording, Seen
from text_reader_vocabulary import (
    ACTIONS,
    AHEAD,
    POSES,
    SIDES,
    WIDER,
    WIDER_AGES,
    WIDER_PARTNERS,
    WIDER_VERBS,
    Reading,
)

KNOWN = set().union(*ACTIONS.values())
"""All labels of actions: a list with another label tells only what it names."""


def turn(angle: float) -> float:
    """An angle between -180 and 180 degrees."""
    return (angle + 180) % 360 - 180


def either(*facts: bool | None) -> bool | None:
    return True if True in facts else None if None in facts else False


def all_of(facts: Iterable[bool | None]) -> bool | None:
    unknown = False
    for fact in facts:
        if fact is False:
            return False
        unknown = unknown or fact is None
    return None if unknown else True


def best(levels: Iterable[int]) -> bool | None:
    """What difficulty codes of the same fact say: certain, doubtful, or not listed."""
    least = min(levels, default=9)
    return True if least <= CERTAIN else None if least <= 3 else False


class Facts:
    """Facts of one recording under one reading; every method takes people by number and a frame."""

    def __init__(self, recording: Recording, reading: Reading):
        self.recording, self.reading = recording, reading

    def seen(self, person: int, frame: int) -> Seen | None:
        return self.recording.frames.get(frame, {}).get(person)

    def people(self, frame: int) -> dict[int, Seen]:
        return self.recording.frames.get(frame, {})

    # What one person does and is.

    def labelled(self, person: int, frame: int, labels: set[str], poses: bool) -> bool | None:
        seen = self.seen(person, frame)
        if seen is None or not seen.actions:
            return None
        whole = seen.actions.keys() <= KNOWN
        certain = {label for label, level in seen.actions.items() if level <= CERTAIN}
        listed = seen.actions.keys() & set(POSES.values())
        if poses and (len(listed) != 1 or not listed <= certain or not whole):
            return None
        if labels & certain:
            return True
        return None if labels & seen.actions.keys() or not whole else self.between(person, frame, labels)

    def between(self, person: int, frame: int, labels: set[str]) -> bool | None:
        """None in a short break of a label, False outside."""
        if self.recording.step != 1:
            return False
        for way in (-1, 1):
            near = (self.seen(person, frame + way * away) for away in range(1, 8))
            if not any(seen is not None and labels & seen.actions.keys() for seen in near):
                return False
        return None

    def labels(self, phrase: str) -> set[str]:
        """What a phrase stands for among the actions."""
        return ACTIONS[phrase] | (WIDER.get(phrase, set()) if self.reading.words == "wide" else set())

    def doing(self, person: int, frame: int, phrase: str) -> bool | None:
        return self.labelled(person, frame, self.labels(phrase), phrase in POSES)

    def handling(self, person: int, frame: int, verb: str, kind: str) -> bool | None:
        seen = self.seen(person, frame)
        if seen is None or seen.things is None:
            return None
        verbs = {verb} | (WIDER_VERBS.get(verb, set()) if self.reading.words == "wide" else set())
        return best(level for (name, thing), level in seen.things.items() if name in verbs and thing == kind)

    def attribute(self, person: int, kind: str, value: str) -> bool | None:
        votes = self.recording.votes[person][kind] if person in self.recording.votes else None
        if not votes:
            return None
        values = {value} | (WIDER_AGES.get(value, set()) if self.reading.age == "wide" else set())
        count = sum(votes[one] for one in values)
        if count > votes.total() / 2:
            return True
        return None if count and self.reading.votes == "any" else False

    # Where a person is.

    def in_sector(self, person: int, frame: int, axis: int) -> bool | None:
        seen = self.seen(person, frame)
        if seen is None or seen.box is None:
            return None
        return abs(turn(seen.angle - axis)) <= self.reading.sector

    def metres(self, person: int, frame: int) -> float | None:
        seen = self.seen(person, frame)
        if seen is None or seen.place is None:
            return None
        x, y, z = seen.place
        return {"recorded": seen.metres, "ground": math.hypot(x, y), "space": math.hypot(x, y, z)}[self.reading.metres]

    def at_metres(self, person: int, frame: int, low: float, high: float) -> bool | None:
        metres = self.metres(person, frame)
        return None if metres is None else low < metres <= high

    def visible(self, person: int, frame: int) -> bool | None:
        """In the picture at a frame; unknown where a record without a number may be of the person."""
        about = range(frame - 15, frame + 16) if self.reading.seen == "about" else (frame,)
        records = [seen for near in about if (seen := self.seen(person, near)) is not None]
        if any(self.reading.seen != "clear" or not (seen.hidden or seen.doubtful) for seen in records):
            return True
        return None if self.strangers(frame) else False

    def strangers(self, frame: int) -> bool:
        return any(person < 0 for person in self.people(frame))

    # Relations of two people.

    def same_group(self, person: int, other: int, frame: int) -> bool | None:
        one, two = self.seen(person, frame), self.seen(other, frame)
        if one is None or two is None or one.group is None or two.group is None:
            return None
        if one.group != two.group:
            return False
        return True if max(one.grouping, two.grouping) <= CERTAIN else None

    def group_size(self, person: int, frame: int, size: int) -> bool | None:
        own = self.seen(person, frame)
        if own is None or own.group is None or own.grouping > CERTAIN:
            return None
        facts = [self.same_group(person, other, frame) for other in self.people(frame) if other != person]
        least, most = 1 + facts.count(True), 1 + facts.count(True) + facts.count(None)
        if self.reading.group == "around":
            most += len(self.away(own.group, frame))
        return False if not least <= size <= most else True if least == most else None

    def away(self, group: object, frame: int) -> set[int]:
        """Who is not in the picture, but is in the group within a second of it."""
        about = (self.people(near).items() for near in range(frame - 15, frame + 16))
        return {one for people in about for one, seen in people if seen.group == group} - self.people(frame).keys()

    def together(self, person: int, other: int, frame: int, label: str) -> bool | None:
        one, two = self.seen(person, frame), self.seen(other, frame)
        if one is None or two is None:
            return None
        labels = self.partnerships(label)
        sides = [(one.partners or {}, other), (two.partners or {}, person)]
        levels = [partners[name, whom] for partners, whom in sides for name in labels if (name, whom) in partners]
        if levels:
            return best(levels)
        if one.partners is None and two.partners is None:
            return None
        return self.parted(person, other, frame, labels)

    def partnerships(self, label: str) -> set[str]:
        return {label} | (WIDER_PARTNERS.get(label, set()) if self.reading.words == "wide" else set())

    def parted(self, person: int, other: int, frame: int, labels: set[str]) -> bool | None:
        """None in a short break of a relation, False outside."""
        if self.recording.step != 1:
            return False
        for way in (-1, 1):
            near = range(frame + way, frame + way * 8, way)
            if not any(
                self.lists(one, labels, two, at) for at in near for one, two in ((person, other), (other, person))
            ):
                return False
        return None

    def lists(self, person: int, labels: set[str], other: int, frame: int) -> bool:
        seen = self.seen(person, frame)
        return seen is not None and any((label, other) in (seen.partners or {}) for label in labels)

    def with_someone(self, person: int, frame: int, label: str) -> bool | None:
        facts = [self.together(person, other, frame, label) for other in self.people(frame) if other != person]
        seen, labels = self.seen(person, frame), self.partnerships(label)
        own = [level for (name, _), level in ((seen and seen.partners) or {}).items() if name in labels]
        if own and self.reading.partner == "anybody":
            facts.append(True if min(own) <= CERTAIN else None)
        if seen is None or seen.partners is None:
            facts.append(None)
        return either(*facts)

    def aside(self, person: int, other: int, frame: int, side: str) -> float | None:
        """Degrees from one person to another on a side, None on the other side or unknown."""
        one, two = self.seen(person, frame), self.seen(other, frame)
        if one is None or two is None or one.box is None or two.box is None:
            return None
        away = (one.angle - two.angle) * SIDES[side] % 360
        return away if 0 < away < 180 else None

    def first_aside(self, person: int, other: int, frame: int, side: str) -> bool | None:
        """Whether the other is the nearest on a side; unknown where a box is, or where two are as near."""
        people = self.people(frame)
        if any(seen.box is None for seen in people.values()):
            return None
        clear = [one for one, seen in people.items() if not (seen.hidden or seen.doubtful)]
        among = clear if self.reading.beside == "visible" else [*people]
        ways = {one: away for one in among if (away := self.aside(person, one, frame, side)) is not None}
        nearest = [one for one, away in ways.items() if away == min(ways.values())]
        return False if other not in nearest else True if len(nearest) == 1 else None

    def within(self, person: int, other: int, frame: int, side: str, width: float) -> bool | None:
        one, two = self.seen(person, frame), self.seen(other, frame)
        if one is None or two is None or one.box is None or two.box is None:
            return None
        return 0 < turn(one.angle - two.angle) * SIDES[side] <= width

    def near(self, person: int, other: int, frame: int, low: float, high: float) -> bool | None:
        one, two = self.seen(person, frame), self.seen(other, frame)
        if one is None or two is None or one.place is None or two.place is None:
            return None
        flat = self.reading.metres == "ground"
        metres = math.dist(one.place[:2], two.place[:2]) if flat else math.dist(one.place, two.place)
        return low < metres <= high

    def facing(self, person: int, other: int, frame: int, word: str) -> bool | None:
        """Whether the other is in front of, behind, to the left ... of a person, as that person faces."""
        one, two = self.seen(person, frame), self.seen(other, frame)
        if one is None or two is None or one.place is None or two.place is None or one.heading is None:
            return None
        to = math.atan2(two.place[1] - one.place[1], two.place[0] - one.place[0])
        angle = turn(math.degrees(to - one.heading))
        if word.endswith("right"):
            word, angle = word.replace("right", "left"), -angle
        if word in ("in front of", "behind"):
            angle = abs(angle)
        low, high = {
            "drawn": ((0, 30), (30, 45), (45, 135), (135, 145), (145, 180)),
            "eighths": ((0, 22.5), (22.5, 67.5), (67.5, 112.5), (112.5, 157.5), (157.5, 180)),
            "quarters": ((0, 45), (0, 90), (45, 135), (90, 180), (135, 180)),
            "halves": ((0, 90), (0, 90), (0, 180), (90, 180), (90, 180)),
        }[self.reading.facing][AHEAD[word]]
        return low <= angle <= high
