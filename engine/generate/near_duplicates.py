"""Near-duplicates and caps: which questions may stand beside each other.

`Taken` keeps account of the questions that are chosen. It depends on the rows alone, never on their order.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

from jrdb_avr.schema.rules import Rules, frames

Person = tuple[str, int]
"""Sequence and track."""


def near_frames(template: str, rules: Rules) -> int:
    """Frames within which two questions of a template read the same."""
    return frames(rules.near_presence_s if template == "presence" else rules.near_duplicate_s)


class Subject(NamedTuple):
    """What a question is about; the columns are those of `selection.POOL`."""

    person: Person
    template: str
    read: tuple[int, ...]
    event: str | None


@dataclass
class Taken:
    """The questions chosen so far, of all templates, and so which may not be chosen besides."""

    rules: Rules
    reads: dict[tuple[Person, str], list[tuple[int, ...]]] = field(default_factory=lambda: defaultdict(list))
    events: set[tuple[Person, str]] = field(default_factory=set)
    questions: Counter[Person] = field(default_factory=Counter)

    def admits(self, one: Subject) -> bool:
        """Whether no near-duplicate and no cap forbids a question."""
        others = self.reads[one.person, one.template]
        if len(others) >= self.rules.max_per_person or self.questions[one.person] >= self.rules.max_per_person_in_all:
            return False
        if one.event is not None and (one.person, one.event) in self.events:
            return False
        near = near_frames(one.template, self.rules)
        return not any(_close(one.read, other, near) for other in others)

    def add(self, one: Subject) -> None:
        """Count a question as chosen."""
        self.reads[one.person, one.template].append(one.read)
        self.questions[one.person] += 1
        if one.event is not None:
            self.events.add((one.person, one.event))

    def remove(self, one: Subject) -> None:
        """Count a question as chosen no more."""
        self.reads[one.person, one.template].remove(one.read)
        self.questions[one.person] -= 1
        self.events.discard((one.person, one.event or ""))


def _close(one: tuple[int, ...], other: tuple[int, ...], near: int) -> bool:
    """Whether all frames of two questions lie near each other; forms that read at more frames are not alike."""
    return len(one) == len(other) and all(abs(a - b) <= near for a, b in zip(one, other, strict=True))
