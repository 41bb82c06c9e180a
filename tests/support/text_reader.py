"""A careful reader of questions: finds the person and the answer from the text and the raw labels alone.

It takes no plan and no bindings. `Reader.disputes` follows a question under the ordinary readings of its words and
reports those that find nobody, several people, another person or another answer than the rest.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from text_reader_facts import Facts, all_of, turn
from text_reader_labels import Recording, Seen
from text_reader_vocabulary import FPS, HELD, OPEN, PARTNERS, POSES, Reading
from text_reader_words import Link, Question, Step, parse


class ConfusedError(Exception):
    """The reader finds nobody, several people or no answer; the message says which."""


@dataclass(frozen=True)
class Found:
    """The person whom a question is about, and its answer."""

    target: int
    answer: dict


NEEDS = {
    "sector": {"in_sector"},
    "beside": {"first_aside"},
    "window": {"within"},
    "facing": {"facing"},
    "metres": {"at_metres", "near", "distance"},
    "words": {"doing", "handling", "together", "with_someone", "pose", "start", "span", "view", "starts", "next_pose"},
    "group": {"group_size", "mates"},
    "seen": {"presence", "distance", "absence"},
    "spell": {"start", "span", "view", "starts", "count"},
    "pause": {"start", "span", "view", "starts"},
    "votes": {"attribute"},
    "age": {"attribute"},
    "partner": {"with_someone"},
    "change": {"distance"},
    "moment": {"view"},
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


def open_readings(question: Question) -> list[Reading]:
    """The further readings, one word at a time."""
    return [replace(Reading(), **{word: value}) for word in words_of(question) for value in OPEN.get(word, ())]


class Reader:
    """Answers questions about one sequence of a root."""

    def __init__(self, root: Path, sequence: str):
        self.recording = Recording(root, sequence)

    def find(self, question: Question, choices: list[str], reading: Reading) -> Found:
        """Person and answer under one reading. Raises ConfusedError where there is not exactly one."""
        return _Search(self.recording, question, choices, Facts(self.recording, reading)).found()

    def disputes(self, text: str, choices: list[str], stored: Found, readings=held_readings) -> list[str]:
        """What speaks against a stored person and answer: a line for every reading that finds others."""
        question, complaints = parse(text), []
        for reading in readings(question):
            try:
                complaint = differs(self.find(question, choices, reading), stored)
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


@dataclass
class _Search:
    """One question under one reading."""

    recording: Recording
    question: Question
    choices: list[str]
    facts: Facts
    person: int = 0

    def found(self) -> Found:
        frame, conditions = self.question.frame, self.question.conditions
        fits = {one: all_of(self.holds(each, one) for each in conditions) for one in self.facts.people(frame)}
        named = {"A": only(fits, "A")}
        for step in self.question.steps:
            named[step.name] = self.follow(step, named)
        self.person = [*named.values()][-1]
        return Found(self.person, getattr(self, f"read_{self.question.read}")())

    def holds(self, condition, person: int) -> bool | None:
        fact, values = getattr(self.facts, condition.fact), condition.values
        return fact(person, *values) if condition.fact == "attribute" else fact(person, self.question.frame, *values)

    def follow(self, step: Step, named: dict[str, int]) -> int:
        out = {named[name] for name in step.aside} | {named[link.start] for link in step.links}
        others = self.facts.people(self.question.frame).keys() - out
        fits = {one: all_of(self.leads(link, named[link.start], one) for link in step.links) for one in others}
        return only(fits, step.name)

    def leads(self, link: Link, start: int, other: int) -> bool | None:
        frame = self.question.frame
        if link.fact == "mates":
            certain, possible = self.facts.members(start, frame)
            if possible - self.facts.people(frame).keys():
                raise ConfusedError("somebody of the group is out of the picture")
            return True if other in certain else None if other in possible else False
        return getattr(self.facts, link.fact)(start, other, frame, *link.values)

    # What is read of the last person.

    def seen(self, frame: int) -> Seen | None:
        return self.facts.seen(self.person, frame)

    def later(self) -> list[int]:
        return [frame for frame in self.recording.order if frame > self.question.frame]

    def read_pose(self, frame: int | None = None) -> dict:
        frame = frame if frame is not None else (*self.question.values, self.question.frame)[0]
        chosen = only({choice: self.facts.doing(self.person, frame, choice) for choice in self.choices}, "choices")
        return self.choice(chosen)

    def choice(self, words: str) -> dict:
        return {"choice": self.choices.index(words) + 1}

    def read_next_pose(self) -> dict:
        def pose(frame: int) -> str | None:
            """The one pose that is certain at a frame."""
            listed = (self.seen(frame) or Seen(None)).actions
            poses = [label for label in POSES.values() if label in listed]
            return poses[0] if len(poses) == 1 and listed[poses[0]] < 3 else None

        first = pose(self.question.frame)
        return self.read_pose(next((frame for frame in self.later() if pose(frame) not in (None, first)), -1))

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
        angle, before = self.facts.people(first)[self.person].angle, self.seen(first - self.recording.step)
        if self.facts.reading.moment == "between" and before is not None:
            angle = (before.angle + turn(angle - before.angle) / 2) % 360
        return {"frame": first - self.half, "angle_deg": angle}

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
        if label:
            return self.facts.together(self.person, other, frame, label) is True
        one, two = self.seen(frame), self.facts.seen(other, frame)
        if self.facts.reading.spell == "possible":
            return one is not None and two is not None and one.group is not None and one.group == two.group
        return self.facts.same_group(self.person, other, frame) is True

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
        same = 1 if self.facts.reading.change == "metres" else 0.15 * one
        if abs(two - one) < same:
            return self.choice("about the same distance")
        return self.choice("closer to the robot" if two < one else "farther from the robot")


def only(fits: dict, name: str):
    """The one who certainly fits while nobody else could."""
    possible = [one for one, fact in fits.items() if fact is not False]
    if len(possible) > 1:
        raise ConfusedError(f"{name}: several fit: {sorted(possible)}")
    if not possible or not fits[possible[0]]:
        raise ConfusedError(f"{name}: nobody certainly fits")
    return possible[0]


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
