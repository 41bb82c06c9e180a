"""Raw label files of one sequence as plain records: what the text reader knows of the world.

It reads the JSON itself and shares no code with the loaders. Every record of a frame is kept that may be a person:
one without a usable number gets a negative one, so that it can still be somebody who fits a description.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache, cached_property
from pathlib import Path

from oracle_covering import hidden_share
from text_reader_language import (
    ACTIONS,
    AHEAD,
    FPS,
    HELD,
    PARTNERS,
    POSES,
    SIDES,
    WIDER,
    WIDER_AGES,
    WIDER_CHOICES,
    WIDER_PARTNERS,
    WIDER_VERBS,
    Condition,
    Link,
    Question,
    Reading,
    Step,
    parse,
)

WIDTH = 3760
SOCIAL = ("labels_2d_activity_social_stitched", "labels_2d_social")
REASONING = ("labels_2d_stitched_new_version", "labels_2d_stitched_test_new_version1")
PANOPTIC = ("labels_2d_panoptic_stitched_CW", "labels_2d_panoptic_stitched_OW")
OCCLUSIONS = ("Fully_visible", "Mostly_visible", "Severely_occluded", "Fully_occluded")
CERTAIN = 2
"""The highest difficulty code of a label that annotators were sure of."""


@dataclass
class Seen:
    """One record of a person in one frame."""

    box: tuple[float, float, float, float] | None
    hidden: bool | None = None
    occlusion: str | None = None
    doubtful: bool = False
    actions: dict[str, int] = field(default_factory=dict)
    group: object = None
    grouping: int = 3
    partners: dict[tuple[str, int], int] | None = None
    things: dict[tuple[str, str], int] | None = None
    place: tuple[float, float, float] | None = None
    heading: float | None = None
    metres: float | None = None

    @property
    def angle(self) -> float:
        x, _, width, _ = self.box
        return (x + width / 2) / WIDTH * 360 % 360


def code(value) -> int:
    """A difficulty from 1 to 3; what cannot be read is as doubtful as the hardest."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return 3
    return int(number) if number in (1, 2, 3) else 3


@cache
def plain(label: str) -> str:
    """One spelling of a label."""
    text = re.sub(r"[_\-\s]+", " ", str(label)).strip().lower().replace("something", "sth")
    return re.sub(r"\btogether together\b", "together", text)


def labels_of(value) -> dict[str, int]:
    return {plain(name): code(level) for name, level in value.items()} if isinstance(value, dict) else {}


def track_of(label) -> int | None:
    """The number of a person, 0 for a person without one, and None for a thing."""
    text = str(label).strip()
    if found := re.fullmatch(r"pedestrian:(\d+)", text):
        return int(found[1]) + 1
    return 0 if re.match(r"(ped|person|people|human|rider|bicyclist|other)", text, re.IGNORECASE) else None


def listed(record: dict, *keys: str) -> list | None:
    for key in keys:
        if isinstance(record.get(key), list):
            return [entry for entry in record[key] if isinstance(entry, dict)]
    return None


class Recording:
    """People by frame of one sequence. Numbers of people are those of the files; strangers have negative ones."""

    def __init__(self, root: Path, sequence: str):
        self.root, self.sequence = root, sequence
        self.views: dict[tuple[int, int], str] = {}
        self.frames: dict[int, dict[int, Seen]] = {}
        self.votes: dict[int, dict[str, Counter]] = defaultdict(lambda: defaultdict(Counter))
        for frame, records in self.records("labels_2d_stitched"):
            self.frames[frame] = self.people(records)
        for frame, records in self.records(*SOCIAL):
            self.add_social(frame, records)
        for frame, records in self.records(*REASONING):
            self.add_social(frame, records, absent_means_empty=True)
        for frame, records in self.records("labels_3d"):
            self.add_places(frame, records)
        gaps = Counter(later - first for first, later in zip(self.order, self.order[1:], strict=False))
        self.step = gaps.most_common(1)[0][0] if gaps else 1

    @cached_property
    def told(self) -> bool:
        """Whether any box of a person says how far the person is hidden."""
        return any(seen.occlusion in OCCLUSIONS for people in self.frames.values() for seen in people.values())

    @cached_property
    def grouped(self) -> list[int]:
        """The frames with a group label of anybody."""
        return [frame for frame in self.order if any(seen.group is not None for seen in self.frames[frame].values())]

    def view(self, person: int, frame: int) -> str:
        """Whether a person with a record is clear, covered or uncertain in a frame."""
        if (person, frame) not in self.views:
            self.views[person, frame] = self.judge(person, frame)
        return self.views[person, frame]

    def judge(self, person: int, frame: int) -> str:
        people = self.frames[frame]
        seen = people[person]
        if seen.box is None or person < 0:
            return "uncertain"
        _, top, width, height = seen.box
        fits = top >= 0 and top + height <= 480 and 12 <= width <= 480 and height >= 40 and not seen.doubtful
        if self.told:
            if seen.occlusion in OCCLUSIONS[2:]:
                return "covered"
            return "clear" if fits and seen.occlusion in OCCLUSIONS[:2] else "uncertain"
        others = [other.box for one, other in people.items() if one >= 0 and one != person and other.box is not None]
        share = hidden_share(seen.box, others)
        if share is None:
            return "uncertain"
        if share >= Fraction(8, 10):
            return "covered"
        return "clear" if fits and share < Fraction(1, 2) and self.in_group_about(person, frame) else "uncertain"

    def in_group_about(self, person: int, frame: int) -> bool:
        if not self.grouped:
            return True
        nearest = min(self.grouped, key=lambda one: (abs(one - frame), one))
        seen = self.frames[nearest].get(person)
        return abs(nearest - frame) <= FPS and seen is not None and seen.group is not None and seen.grouping <= CERTAIN

    @cached_property
    def order(self) -> list[int]:
        return sorted(self.frames)

    def file(self, *folders: str) -> dict:
        for folder in folders:
            for path in (self.root / "labels" / folder, self.root / folder):
                if (path / f"{self.sequence}.json").exists():
                    return json.loads((path / f"{self.sequence}.json").read_text("utf-8"))
        return {}

    def records(self, *folders: str):
        for name, records in self.file(*folders).get("labels", {}).items():
            if isinstance(records, list) and (stem := Path(name).stem).isdigit():
                yield int(stem), [record for record in records if isinstance(record, dict)]

    def people(self, records: list[dict]) -> dict[int, Seen]:
        people: dict[int, Seen] = {}
        for record in records:
            number = track_of(record.get("label_id"))
            if number is None:
                continue
            # The second of two records of a number may be somebody else's.
            unnumbered = not number or number - 1 in people
            people[-1 - len(people) if unnumbered else number - 1] = self.seen(record)
        return people

    def seen(self, record: dict) -> Seen:
        box, marks = record.get("box"), record.get("attributes")
        usable = isinstance(box, list) and len(box) == 4 and all(isinstance(side, int | float) for side in box)
        marks = marks if isinstance(marks, dict) else {}
        occlusion = marks.get("occlusion")
        group = record.get("social_group")
        group = group if isinstance(group, dict) else {}
        return Seen(
            box=tuple(box) if usable and box[2] > 0 and box[3] > 0 else None,
            occlusion=occlusion if marks.get("no_eval") in (None, True, False, "true", "false") else None,
            hidden=None if occlusion is None else occlusion not in ("Fully_visible", "Mostly_visible"),
            doubtful=marks.get("no_eval") in (True, "true"),
            actions=labels_of(record.get("action_label")),
            group=group.get("cluster_ID"),
            grouping=code(group.get("cluster_stat")),
        )

    def known(self, frame: int, record: dict) -> tuple[int, Seen] | None:
        number = track_of(record.get("label_id"))
        seen = self.frames.get(frame, {}).get(number - 1) if number else None
        return None if seen is None or not number else (number - 1, seen)

    def add_social(self, frame: int, records: list[dict], absent_means_empty: bool = False) -> None:
        for record in records:
            if (found := self.known(frame, record)) is None:
                continue
            number, seen = found
            if absent_means_empty:
                record = {"HHI": [], "HOI": [], **record}
            for entry in listed(record, "demographics_info") or ():
                for kind in ("gender", "age"):
                    for value, level in labels_of(entry.get(kind)).items():
                        if level <= CERTAIN and value != "impossible":
                            self.votes[number][kind][value] += 1
            if (entries := listed(record, "H-interaction", "HHI")) is not None:
                seen.partners = {} if seen.partners is None else seen.partners
                for entry in entries:
                    other = entry.get("pair")
                    other = (
                        track_of(other) if isinstance(other, str) and ":" in other else track_of(f"pedestrian:{other}")
                    )
                    for label, level in labels_of(entry.get("inter_labels")).items():
                        key = (label, (other or 0) - 1)
                        seen.partners[key] = min(level, seen.partners.get(key, 3))
            if (entries := listed(record, "HOI")) is not None:
                seen.things = {} if seen.things is None else seen.things
                for entry in entries:
                    pair = entry.get("pair")
                    kind = self.kinds.get(int(pair[1]), "") if isinstance(pair, list) and len(pair) == 2 else ""
                    for verb, level in labels_of(entry.get("inter_labels")).items():
                        seen.things[verb, kind] = min(level, seen.things.get((verb, kind), 3))

    @cached_property
    def kinds(self) -> dict[int, str]:
        """Names of things by category number."""
        return {
            row["id"]: re.sub(r"^[tm] ", "", plain(row["name"])) for row in self.file(*PANOPTIC).get("categories", [])
        }

    def add_places(self, frame: int, records: list[dict]) -> None:
        for record in records:
            found, box = self.known(frame, record), record.get("box")
            marks = record.get("attributes") or {}
            if found is None or not isinstance(box, dict) or not marks.get("num_points"):
                continue
            try:
                seen, place = found[1], (float(box["cx"]), float(box["cy"]), float(box["cz"]))
                seen.place, seen.heading = place, math.pi - float(box["rot_z"])
            except (KeyError, TypeError, ValueError):
                continue
            metres = marks.get("distance")
            seen.metres = float(metres) if isinstance(metres, int | float) else math.hypot(*place[:2])


OFTEN_MISSED = ("looking at the robot", "looking at something", "pointing at something", "using a door")
"""What labels often miss between two seconds that have it."""

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

    def __init__(self, recording: Recording, reading: Reading, judged: bool = False):
        self.recording, self.reading, self.judged = recording, reading, judged

    def seen(self, person: int, frame: int) -> Seen | None:
        return self.recording.frames.get(frame, {}).get(person)

    def people(self, frame: int) -> dict[int, Seen]:
        """Everybody with a record, but for covered people if only people in clear view count."""
        people = self.recording.frames.get(frame, {})
        return {one: seen for one, seen in people.items() if not self.covered(one, frame)} if self.judged else people

    def covered(self, person: int, frame: int) -> bool:
        return self.judged and self.recording.view(person, frame) == "covered"

    def clear(self, person: int, frame: int) -> bool:
        """Whether somebody with a record in the frame is in clear view."""
        if self.judged:
            return self.recording.view(person, frame) == "clear"
        seen = self.recording.frames[frame][person]
        return not (seen.hidden or seen.doubtful)

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
            return None if self.covered(person, frame) else True
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
        fact = self.labelled(person, frame, self.labels(phrase), phrase in POSES)
        if fact is False and self.judged and phrase in OFTEN_MISSED:
            near = (self.seen(person, frame + by) for by in (-FPS, FPS))
            return None if any(one is not None and ACTIONS[phrase] & one.actions.keys() for one in near) else False
        return fact

    def performs(self, person: int, frame: int, phrase: str) -> bool | None:
        """Whether a choice is right: surely, surely not, or by a label that some would call so."""
        seen = self.seen(person, frame)
        if seen is None or not seen.actions or self.covered(person, frame):
            return None
        own, whole = ACTIONS[phrase], seen.actions.keys() <= KNOWN
        certain = {label for label, level in seen.actions.items() if level <= CERTAIN}
        poses = seen.actions.keys() & set(POSES.values())
        one_pose = phrase not in POSES or (len(poses) == 1 and poses <= certain)
        if own & certain and one_pose and (whole or phrase not in POSES):
            return True
        called = own | WIDER.get(phrase, set()) | WIDER_CHOICES.get(phrase, set())
        return None if called & seen.actions.keys() or not whole or not one_pose else False

    def about(self, person: int, frame: int, phrase: str, seconds: int) -> set[int]:
        """Difficulties of a choice's own labels in so many seconds before and after a time."""
        steps = (by for by in range(-seconds, seconds + 1) if by)
        about = (self.seen(person, frame + by * FPS) for by in steps)
        return {level for seen in about if seen for label, level in seen.actions.items() if label in ACTIONS[phrase]}

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
        records = [near for near in about if self.seen(person, near) is not None]
        if any(self.reading.seen != "clear" or self.clear(person, near) for near in records):
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
        facts = [self.member(person, other, frame) for other in self.people(frame) if other != person]
        least, most = 1 + facts.count(True), 1 + facts.count(True) + facts.count(None)
        if self.reading.group == "around" and not self.judged:
            most += len(self.away(own.group, frame))
        return False if not least <= size <= most else True if least == most else None

    def member(self, person: int, other: int, frame: int) -> bool | None:
        """Whether the other is in the person's group and, if only such people count, in clear view."""
        fact, seen = self.same_group(person, other, frame), self.seen(other, frame)
        if not self.judged:
            return fact
        if seen is None or seen.group is None or seen.grouping > CERTAIN:
            return None
        return None if fact and not self.clear(other, frame) else fact

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
        facts = []
        for other in self.recording.frames.get(frame, {}):
            fact = other != person and self.together(person, other, frame, label)
            facts.append(None if fact and self.judged and not self.clear(other, frame) else fact)
        seen, labels = self.seen(person, frame), self.partnerships(label)
        own = [level for (name, _), level in ((seen and seen.partners) or {}).items() if name in labels]
        if own and self.reading.partner == "anybody" and not self.judged:
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
        clear = [one for one in people if self.clear(one, frame)]
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


def phrase_of(choice: str) -> str:
    """The phrase of a choice, without its examples."""
    return choice.partition(" (")[0]


class ConfusedError(Exception):
    """The reader finds nobody, several people or no answer; the message says which."""


def only(fits: dict, name: str):
    """The one who certainly fits while nobody else could."""
    possible = [one for one, fact in fits.items() if fact is not False]
    if len(possible) > 1:
        raise ConfusedError(f"{name}: several fit: {sorted(possible)}")
    if not possible or not fits[possible[0]]:
        raise ConfusedError(f"{name}: nobody certainly fits")
    return possible[0]


@dataclass
class Asked:
    """A question about one person under one reading."""

    question: Question
    choices: list[str]
    facts: Facts
    person: int

    @property
    def recording(self) -> Recording:
        return self.facts.recording

    def answer(self) -> dict:
        return getattr(self, f"read_{self.question.read}")()

    def seen(self, frame: int) -> Seen | None:
        return self.facts.seen(self.person, frame)

    def later(self) -> list[int]:
        return [frame for frame in self.recording.order if frame > self.question.frame]

    def read_action(self) -> dict:
        frame = (*self.question.values, self.question.frame)[0]
        chosen = self.chosen(frame)
        if min(self.facts.about(self.person, frame, phrase_of(chosen), 1), default=9) > CERTAIN:
            raise ConfusedError(f"choices: {chosen} is labelled for a moment only")
        return self.choice(chosen)

    def chosen(self, frame: int) -> str:
        """The one choice that is right at a frame; labels beside the frame may not make another one right."""
        facts = {choice: self.facts.performs(self.person, frame, phrase_of(choice)) for choice in self.choices}
        right = only(facts, "choices")
        for choice in self.choices:
            phrase = phrase_of(choice)
            if re.search(rf"\b{phrase}\b", self.question.text):
                raise ConfusedError(f"choices: the text says {phrase}")
            if choice != right and self.facts.about(self.person, frame, phrase, 1 if phrase in POSES else 3):
                raise ConfusedError(f"choices: {choice} is labelled about that time, too")
        return right

    def choice(self, words: str) -> dict:
        return {"choice": self.choices.index(words) + 1}

    def read_next_pose(self) -> dict:
        def pose(frame: int) -> str | None:
            """The one pose that is certain at a frame."""
            listed = (self.seen(frame) or Seen(None)).actions
            poses = [label for label in POSES.values() if label in listed]
            return poses[0] if len(poses) == 1 and listed[poses[0]] < 3 else None

        first = pose(self.question.frame)
        later = (frame for frame in self.later() if frame % FPS == 0 or self.recording.step != 1)
        return self.choice(self.chosen(next((frame for frame in later if pose(frame) not in (None, first)), -1)))

    def spell(self, phrase: str) -> tuple[int, int]:
        """First and last frame of the first spell of an action after the description."""
        longest, first, last, before = max(self.facts.reading.pause, self.recording.step), None, 0, self.question.frame
        for frame in self.later():
            if first is not None and frame - last > longest:
                break
            if (seen := self.seen(frame)) is None:
                continue
            if self.does(seen, phrase, frame):
                if first is None and frame - before > FPS:
                    raise ConfusedError(f"nobody sees the start of {phrase}")
                first, last = frame if first is None else first, frame
            before = frame
        if first is None:
            raise ConfusedError(f"never {phrase}")
        return first, last

    def does(self, seen: Seen, phrase: str, frame: int) -> bool:
        if not self.facts.labels(phrase) & seen.actions.keys():
            return False
        fact = self.facts.doing(self.person, frame, phrase)
        if fact is None and self.facts.reading.spell == "possible":
            return True
        return fact is True

    @property
    def half(self) -> int:
        """What lies between the first label and the start: half a step where labels come once per second."""
        return self.recording.step // 2

    def read_start(self) -> dict:
        return {"frame": self.spell(self.question.values[0])[0] - self.half}

    def read_span(self) -> dict:
        first, last = self.spell(self.question.values[0])
        return {"start_frame": first - self.half, "end_frame": last + self.half}

    def read_view(self) -> dict:
        first, _ = self.spell(self.question.values[0])
        return {"frame": first - self.half, "angle_deg": self.seen(first).angle}

    def read_starts(self) -> dict:
        one, two = (self.spell(phrase)[0] for phrase in self.question.values)
        return {"value": (two - one) / FPS}

    def read_absence(self) -> dict:
        last = self.question.frame
        strangers = False
        for frame in self.later():
            clear = self.facts.reading.seen != "clear" or self.facts.visible(self.person, frame)
            if self.seen(frame) is None or not clear:
                strangers = strangers or self.facts.strangers(frame)
                continue
            if frame - last > 2 * max(self.recording.step, FPS):
                if strangers:
                    raise ConfusedError("a record without a number may be of the absent person")
                return {"value": (frame - last) / FPS}
            last, strangers = frame, False
        raise ConfusedError("never away and back")

    def read_count(self) -> dict:
        words, end = self.question.values
        label = PARTNERS.get(words, "")
        frames = [self.question.frame, *(frame for frame in self.later() if frame <= end)]
        met = {other for frame in frames for other in self.facts.people(frame) if self.meets(other, frame, label)}
        return {"value": float(len(met - {self.person}))}

    def meets(self, other: int, frame: int, label: str) -> bool:
        if self.facts.judged and not (self.seen(frame) and self.both_clear(other, frame)):
            return False
        if label:
            return self.facts.together(self.person, other, frame, label) is True
        one, two = self.seen(frame), self.facts.seen(other, frame)
        if self.facts.reading.spell == "possible":
            return one is not None and two is not None and one.group is not None and one.group == two.group
        return self.facts.same_group(self.person, other, frame) is True

    def both_clear(self, other: int, frame: int) -> bool:
        return self.facts.clear(self.person, frame) and self.facts.clear(other, frame)

    def visible(self, frame: int) -> bool:
        if (fact := self.facts.visible(self.person, frame)) is None:
            raise ConfusedError("a record without a number may be of the person")
        return fact

    def read_presence(self) -> dict:
        first, second = (self.visible(frame) for frame in self.question.values)
        if first == second:
            return self.choice("both times" if first else "neither time")
        return self.choice("only at the first time" if first else "only at the second time")

    def read_distance(self) -> dict:
        later = self.question.values[0]
        if not self.visible(later):
            return self.choice("not in view")
        one, two = self.facts.metres(self.person, self.question.frame), self.facts.metres(self.person, later)
        if one is None or two is None:
            raise ConfusedError("a distance is unknown")
        if abs(two - one) < 1:
            return self.choice("about the same distance")
        return self.choice("closer to the robot" if two < one else "farther from the robot")


@dataclass(frozen=True)
class Found:
    """The person whom a question is about, and its answer."""

    target: int
    answer: dict


SPELLS = {"start", "span", "view", "starts"}
NEEDS = {
    "sector": {"in_sector"},
    "beside": {"first_aside"},
    "facing": {"facing"},
    "metres": {"at_metres", "near", "distance"},
    "words": {"doing", "handling", "together", "with_someone", "count", *SPELLS},
    "group": {"group_size"},
    "seen": {"presence", "distance", "absence"},
    "spell": {"count", *SPELLS},
    "pause": SPELLS,
    "votes": {"attribute"},
    "age": {"attribute"},
    "partner": {"with_someone"},
}
"""Which facts and which reads each word of a `Reading` bears on."""


def words_of(question: Question) -> list[str]:
    """The words of a question that leave a choice."""
    links = [link for step in question.steps for link in step.links]
    facts = {question.read, *(one.fact for one in question.conditions), *(link.fact for link in links)}
    return [word for word, users in NEEDS.items() if facts & users]


def held_readings(question: Question) -> list[Reading]:
    """Every combination of the readings that are held, the definitions' own first."""
    values = {word: HELD[word] for word in words_of(question) if word in HELD}
    return [Reading(**dict(zip(values, chosen, strict=True))) for chosen in itertools.product(*values.values())]


@functools.cache
def narrowed(reading: Reading, user: str) -> Reading:
    """A reading as far as it bears on one fact or read."""
    return replace(Reading(), **{word: getattr(reading, word) for word, users in NEEDS.items() if user in users})


class Reader:
    """Answers questions about one sequence of a root."""

    def __init__(self, root: Path, sequence: str):
        self.recording = Recording(root, sequence)

    def find(self, question: Question, choices: list[str], reading: Reading) -> Found:
        """Person and answer under one reading. Raises ConfusedError where there is not exactly one."""
        return _Search(self.recording, question, choices).found(reading)

    def disputes(self, text: str, choices: list[str], stored: Found, readings=held_readings) -> list[str]:
        """What speaks against a stored person and answer: a line for every reading that finds others."""
        search, complaints = _Search(self.recording, parse(text), choices), []
        for reading in readings(search.question):
            try:
                complaint = differs(search.found(reading), stored)
            except ConfusedError as error:
                complaint = str(error)
            if complaint:
                complaints.append(f"{complaint} ({reading})")
        return complaints


def differs(found: Found, stored: Found) -> str:
    """Why a stored person and answer are not those found, or nothing."""
    if found.target != stored.target:
        return f"person {found.target} and not {stored.target}"
    return "" if agree(found.answer, stored.answer) else f"{found.answer} and not {stored.answer}"


class _Search:
    """One question under many readings; what two of them say alike is worked out once."""

    def __init__(self, recording: Recording, question: Question, choices: list[str]):
        self.recording, self.question, self.choices = recording, question, choices
        self.people = Facts(recording, Reading(), question.judged).people(question.frame).keys()
        self.fits, self.leads, self.answer = map(functools.cache, (self._fits, self._leads, self._answer))

    def found(self, reading: Reading) -> Found:
        conditions = [self.fits(one, narrowed(reading, one.fact)) for one in self.question.conditions]
        named = {"A": only({one: all_of(fits[one] for fits in conditions) for one in self.people}, "A")}
        for step in self.question.steps:
            named[step.name] = self.follow(step, named, reading)
        target = [*named.values()][-1]
        return Found(target, self.answer(target, narrowed(reading, self.question.read)))

    def follow(self, step: Step, named: dict[str, int], reading: Reading) -> int:
        links = [self.leads(link, named[link.start], narrowed(reading, link.fact)) for link in step.links]
        others = self.people - {named[name] for name in step.aside} - {named[link.start] for link in step.links}
        return only({one: all_of(fits[one] for fits in links) for one in others}, step.name)

    def _fits(self, condition: Condition, reading: Reading) -> dict[int, bool | None]:
        fact, at = getattr(Facts(self.recording, reading, self.question.judged), condition.fact), (self.question.frame,)
        at = () if condition.fact == "attribute" else at
        return {one: fact(one, *at, *condition.values) for one in self.people}

    def _leads(self, link: Link, start: int, reading: Reading) -> dict[int, bool | None]:
        fact = getattr(Facts(self.recording, reading, self.question.judged), link.fact)
        return {one: fact(start, one, self.question.frame, *link.values) for one in self.people - {start}}

    def _answer(self, person: int, reading: Reading) -> dict:
        facts = Facts(self.recording, reading, self.question.judged)
        return Asked(self.question, self.choices, facts, person).answer()


def agree(one: dict, other: dict) -> bool:
    """Whether an answer scores against another, by docs/definitions.md."""
    if "choice" in one:
        return one["choice"] == other["choice"]
    if "value" in one:
        low, high = sorted((one["value"], other["value"]))
        return 0 < high <= 2 * low
    if "start_frame" in one:
        both, either = (set(spread(one)) & set(spread(other)), set(spread(one)) | set(spread(other)))
        return 2 * len(both) >= len(either)
    near = abs(one["frame"] - other["frame"]) <= FPS
    return near and ("angle_deg" not in one or abs(turn(one["angle_deg"] - other["angle_deg"])) <= 20 + 1e-9)


def spread(answer: dict) -> Iterable[int]:
    return range(answer["start_frame"], answer["end_frame"] + 1)
