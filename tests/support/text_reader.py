"""A careful reader of questions: finds the person and the answer from the text and the raw labels alone.

It takes no plan and no bindings. `Reader.disputes` follows a question under the ordinary readings of its words and
reports those that find nobody, several people, another person or another answer than the rest.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from text_reader_answers import Asked, ConfusedError, only
from text_reader_facts import Facts, all_of, turn
from text_reader_labels import Recording
from text_reader_vocabulary import FPS, HELD, OPEN, Reading
from text_reader_words import Condition, Link, Question, Step, parse


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
    "words": {"doing", "handling", "together", "with_someone", "pose", "next_pose", "count", *SPELLS},
    "group": {"group_size"},
    "seen": {"presence", "distance", "absence"},
    "spell": {"count", *SPELLS},
    "pause": SPELLS,
    "votes": {"attribute"},
    "age": {"attribute"},
    "partner": {"with_someone"},
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
        self.people = recording.frames.get(question.frame, {}).keys()
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
        fact, at = getattr(Facts(self.recording, reading), condition.fact), (self.question.frame,)
        at = () if condition.fact == "attribute" else at
        return {one: fact(one, *at, *condition.values) for one in self.people}

    def _leads(self, link: Link, start: int, reading: Reading) -> dict[int, bool | None]:
        fact = getattr(Facts(self.recording, reading), link.fact)
        return {one: fact(start, one, self.question.frame, *link.values) for one in self.people - {start}}

    def _answer(self, person: int, reading: Reading) -> dict:
        return Asked(self.question, self.choices, Facts(self.recording, reading), person).answer()


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
