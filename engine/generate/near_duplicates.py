"""Near-duplicates and caps, which decide whether two questions may both be chosen."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import sub

from jrdb_avr.engine.generate.asked import Candidate
from jrdb_avr.schema.rules import Rules, frames

Person = tuple[str, int]
"""Sequence and track."""


def near_frames(template: str, rules: Rules) -> int:
    """Return the maximum number of frames between the times of two questions that read the same."""
    return frames(rules.near_presence_s if template == "presence" else rules.near_duplicate_s)


@dataclass
class Taken:
    """Account of the chosen questions of all templates. It never depends on their order."""

    rules: Rules
    reads: dict[tuple[Person, str], list[tuple[int, ...]]] = field(default_factory=lambda: defaultdict(list))
    events: set[tuple[Person, str]] = field(default_factory=set)
    questions: Counter[Person] = field(default_factory=Counter)

    def admits(self, one: Candidate) -> bool:
        """Return whether no near-duplicate and no cap forbids a question."""
        others = self.reads[one.person, one.template]
        if len(others) >= self.rules.max_per_person or self.questions[one.person] >= self.rules.max_per_person_in_all:
            return False
        if one.event is not None and (one.person, one.event) in self.events:
            return False
        if not others:
            return True
        near = near_frames(one.template, self.rules)
        return not any(are_near(one.asked, other, near) for other in others)

    def add(self, one: Candidate) -> None:
        """Count a question as chosen."""
        self.reads[one.person, one.template].append(one.asked)
        self.questions[one.person] += 1
        if one.event is not None:
            self.events.add((one.person, one.event))

    def remove(self, one: Candidate) -> None:
        """Count a question as chosen no more."""
        self.reads[one.person, one.template].remove(one.asked)
        self.questions[one.person] -= 1
        self.events.discard((one.person, one.event or ""))


def are_near(one: Sequence[int], other: Sequence[int], near: int) -> bool:
    """Return whether all frames of two questions are near each other. Forms that read at more frames are not alike."""
    return len(one) == len(other) and max(map(abs, map(sub, one, other))) <= near
